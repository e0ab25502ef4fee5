"use strict";
/* Sorting by a click on a heading, and showing only logs with given words. */

const body = document.querySelector("#flights tbody");

function key(row, column) {
  const cell = row.cells[column];
  return cell.dataset.v !== undefined ? Number(cell.dataset.v) : cell.textContent.toLowerCase();
}

function sortBy(column, down) {
  const rows = [...body.rows];
  rows.sort((a, b) => {
    const x = key(a, column), y = key(b, column);
    if (x === "" || y === "") return (x === "") - (y === "");  // what is unknown stays below
    return (x < y ? -1 : x > y ? 1 : a.dataset.order - b.dataset.order) * (down ? -1 : 1);
  });
  body.append(...rows);
}

if (body) {
  document.querySelectorAll("#flights th").forEach((head, column) => {
    let down = head.classList.contains("number");  // the largest first, names from a to z
    head.addEventListener("click", () => { sortBy(column, down); down = !down; });
  });
  document.getElementById("filter").addEventListener("input", (event) => {
    const words = event.target.value.toLowerCase().split(/\s+/);
    for (const row of body.rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  });
}
