"""Many logs: each isolated, none done twice, the same bits wherever they are worked on."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import distributed
import msgspec
import pytest

from companion.types import CompanionError, ConfigError
from replay.batch import scheduling, store, worker
from replay.batch.listing import find_logs
from replay.batch.outcome import Outcome, Row
from replay.batch.outliers import FEWEST, ranked
from replay.children import Child

PATIENCE_S = 240.0


@dataclass(frozen=True, slots=True)
class Batch:
    """A finished command: what it said, and its table."""

    said: dict[str, Any]
    table: dict[str, dict[str, str]]


def batch(*arguments: object) -> Batch:
    """Run the command as a user does."""
    words = [sys.executable, "-m", "companion", "batch", *map(str, arguments), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    with Path(said["table"]).open(encoding="utf-8") as file:
        return Batch(said, {row["log"]: row for row in csv.DictReader(file)})


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory, sample_flight: Path) -> Path:
    """Three first parts of the sample flight, and one log of nonsense."""
    folder = tmp_path_factory.mktemp("logs")
    whole = sample_flight.read_bytes()
    (folder / "deep").mkdir()
    for name, percent in (("deep/more.tlog", 40), ("third.tlog", 33), ("quarter.tlog", 25)):
        (folder / name).write_bytes(whole[: len(whole) * percent // 100])
    (folder / "nonsense.tlog").write_bytes(b"\x17" * 5000)
    (folder / "notes.txt").write_text("not a log")
    return folder


@pytest.fixture(scope="module")
def first(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Batch]:
    """A batch of them, and where it lies."""
    out = tmp_path_factory.mktemp("first")
    return out, batch(logs, "-o", out, "--workers", 2)


def test_each_log_is_a_row_and_a_page(first: tuple[Path, Batch]) -> None:
    out, made = first
    assert set(made.table) == {"deep/more.tlog", "quarter.tlog", "third.tlog", "nonsense.tlog"}
    assert list(made.said["refused"]) == ["nonsense.tlog"]
    assert not made.said["failed"]
    page = (out / "index.html").read_text(encoding="utf-8")
    reports = re.findall(r'<td><a href="([^"]+)"', page)
    assert len(reports) == 3
    assert all((out / report).stat().st_size > 100_000 for report in reports)
    assert not re.search(r'(src|href)="https?:', page)
    longest = made.table["deep/more.tlog"]
    # Position keeps the receiver's slow error, smoothed or not; velocity has none.
    assert float(longest["smoothed_velocity_rmse_mps"]) < float(longest["velocity_rmse_mps"]) < 0.2
    assert float(longest["horizontal_rmse_m"]) < 2


def test_a_second_run_does_nothing_again_but_what_changed(
    first: tuple[Path, Batch], logs: Path, tmp_path: Path
) -> None:
    out = tmp_path / "again"
    shutil.copytree(first[0], out)
    changed = tmp_path / "logs"
    shutil.copytree(logs, changed)
    with (changed / "quarter.tlog").open("ab") as file:
        file.write(b"\x00")
    made = batch(changed, "-o", out, "--workers", 2)
    assert made.said["reused"] == 3
    assert {n: r["digest"] for n, r in made.table.items()} == {
        n: r["digest"] for n, r in first[1].table.items()
    }


def test_what_never_began_leaves_the_page_of_the_last_run(
    first: tuple[Path, Batch], logs: Path, tmp_path: Path
) -> None:
    out = tmp_path / "kept"
    shutil.copytree(first[0], out)
    page = (out / "index.html").read_bytes()
    words = [sys.executable, "-m", "companion", "batch", str(logs), "-o", str(out)]
    done = subprocess.run(
        [*words, "--scheduler", "nonsense://here:1"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("error: no Dask scheduler at nonsense://here:1")
    assert (out / "index.html").read_bytes() == page


def test_a_killed_batch_goes_on_where_it_was(
    logs: Path, first: tuple[Path, Batch], tmp_path: Path
) -> None:
    out = tmp_path / "cut"
    words = [sys.executable, "-m", "companion", "batch", str(logs), "-o", str(out)]
    child = subprocess.Popen([*words, "--workers", "1"], stdout=subprocess.DEVNULL)
    until = time.monotonic() + PATIENCE_S
    while len(done := list((out / "done").glob("*.json"))) < 2:
        assert child.poll() is None
        assert time.monotonic() < until
        time.sleep(0.05)
    child.send_signal(signal.SIGKILL)
    child.wait()
    before = {path.name: path.stat().st_mtime_ns for path in done}
    made = batch(logs, "-o", out, "--workers", 1)
    assert 2 <= made.said["reused"] < 4
    after = {name: (out / "done" / name).stat().st_mtime_ns for name in before}
    assert after == before
    assert not list((out / "done").glob("*.part"))
    for name, row in first[1].table.items():
        assert made.table[name]["digest"] == row["digest"]


def test_a_cluster_gives_the_same_bits(
    logs: Path, first: tuple[Path, Batch], tmp_path: Path
) -> None:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        made = batch(logs, "-o", tmp_path / "out", "--scheduler", cluster.scheduler_address)
    assert made.said["reused"] == 0
    for name, row in first[1].table.items():
        assert made.table[name]["digest_published"] == row["digest_published"]


def _job(path: Path, out: Path, limit_s: float) -> worker.Job:
    settings = store.settings_key(None, 10.0)
    return worker.Job(
        path.name, str(path), str(out), None, settings, store.program(), 10.0, limit_s
    )


@pytest.fixture
def obedient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Children that do what their logs say."""
    monkeypatch.setattr(worker, "Child", lambda name, _: Child(name, ["tests.replay.batch_child"]))


@pytest.mark.usefixtures("obedient")
def test_what_kills_or_hangs_its_process_is_listed_and_the_others_go_on(tmp_path: Path) -> None:
    told = {"a": "die", "b": "hang", "c": "err", "d": "work", "e": "work"}
    jobs = []
    for name, text in told.items():
        (tmp_path / name).write_text(text)
        jobs.append(_job(tmp_path / name, tmp_path, 3.0 if text == "hang" else PATIENCE_S))
    outcomes = {o.log: o for o in scheduling.run(jobs, None, 2)}
    assert {name: o.ended for name, o in outcomes.items()} == {
        "a": "failed", "b": "failed", "c": "failed", "d": "done", "e": "done",
    }  # fmt: skip
    assert "SIGKILL" in outcomes["a"].reason
    assert "3 s" in outcomes["b"].reason
    assert "RuntimeError: as it was told" in outcomes["c"].reason
    # What failed may have been the machine's fault: only what ended is kept.
    assert len(list((tmp_path / "done").glob("*.json"))) == 2


def test_no_more_logs_are_under_way_than_the_workers_can_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = 0
    asked = []

    def found_or_made(job: worker.Job) -> Outcome:
        return Outcome(log=job.log, path=job.path, ended="done", reused=True)

    monkeypatch.setattr(worker, "_found_or_made", found_or_made)
    jobs = [_job(tmp_path / str(at), tmp_path, 1.0) for at in range(60)]

    class Asked(list[worker.Job]):
        def __iter__(self) -> Iterator[worker.Job]:
            for job in super().__iter__():
                asked.append(job)
                yield job

    ended = 0
    for _ in scheduling.run(Asked(jobs), None, 2):
        most = max(most, len(asked) - ended)
        ended += 1
    assert ended == 60
    assert most <= 4


def test_a_scheduler_that_goes_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        worker,
        "_found_or_made",
        lambda job: Outcome(log=job.log, path=job.path, ended="done", reused=True),
    )
    jobs = [_job(tmp_path / str(at), tmp_path, 1.0) for at in range(60)]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as cluster:
        outcomes = scheduling.run(jobs, cluster.scheduler_address, 1)
        next(outcomes)
        cluster.close()
        with pytest.raises(CompanionError, match="scheduler is gone"):
            list(outcomes)


def test_no_scheduler_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduling, "_CONNECT_S", 1.0)
    with pytest.raises(CompanionError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:1"):
        list(scheduling.run([_job(tmp_path, tmp_path, 1.0)], "tcp://127.0.0.1:1", 1))


def test_the_key_is_of_the_log_its_settings_and_the_program(tmp_path: Path) -> None:
    log, config = tmp_path / "a.tlog", tmp_path / "c.toml"
    log.write_bytes(b"one")
    config.write_text("[vehicle]\nname = 'a'\n")
    key = store.log_key(log, store.settings_key(config, 10.0))
    assert key == store.log_key(log, store.settings_key(config, 10.0))
    assert key != store.log_key(log, store.settings_key(config, 20.0))
    config.write_text("[vehicle]\nname = 'b'\n")
    assert key != store.log_key(log, store.settings_key(config, 10.0))
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "imu.csv").write_text("1")
    (folder / "gnss.csv").write_text("2")
    of_folder = store.log_key(folder, "settings")
    (folder / "gnss.csv").write_text("3")
    assert of_folder != store.log_key(folder, "settings")
    config.write_text("nonsense = 1")
    with pytest.raises(ConfigError, match="nonsense"):
        store.settings_key(config, 10.0)


def test_work_without_its_page_is_not_done(tmp_path: Path) -> None:
    outcome = Outcome(log="a", path="a", ended="done", key="k", rows=(_row("reports/a.html"),))
    store.keep(tmp_path, outcome)
    assert store.find(tmp_path, "k") is None
    (tmp_path / "reports").mkdir()
    (tmp_path / "reports" / "a.html").write_text("page")
    assert store.find(tmp_path, "k") == outcome
    (tmp_path / "done" / "k.json").write_text("{")
    assert store.find(tmp_path, "k") is None


def test_folders_are_searched_but_not_the_batch_itself(logs: Path, tmp_path: Path) -> None:
    (logs / "out").mkdir(exist_ok=True)
    shutil.copy(logs / "quarter.tlog", logs / "out" / "copy.tlog")
    assert set(find_logs([logs], logs / "out")) == {
        "deep/more.tlog", "quarter.tlog", "third.tlog", "nonsense.tlog",
    }  # fmt: skip
    shutil.rmtree(logs / "out")
    twice = find_logs([logs / "quarter.tlog", logs], tmp_path)
    assert len(twice) == 4
    with pytest.raises(CompanionError, match="is not there"):
        find_logs([tmp_path / "nowhere"], tmp_path)
    with pytest.raises(CompanionError, match="no log in"):
        find_logs([logs / "deep"], logs / "deep")


def _row(report: str, **figures: Any) -> Row:
    known = {
        "vehicle": "v", "verdict": "good", "headline": "Good: so", "format": "tlog", "config": "",
        "estimator": "error-state", "start_utc": None, "imu": "imu", "reference": "truth",
        "not_smoothed_because": "", "left_out": "", "digest": "", "digest_published": "",
        "report": report,
    }  # fmt: skip
    for field in msgspec.structs.fields(Row):
        if field.name not in known:
            known[field.name] = 0 if field.type is int else 1.0
    return Row(**known | figures)


def test_what_stands_out_comes_first_and_says_why() -> None:
    def one(name: str, **figures: Any) -> Outcome:
        return Outcome(log=name, path=name, ended="done", rows=(_row(name, **figures),))

    usual = [one(f"u{at}", horizontal_rmse_m=1.0 + 0.05 * at) for at in range(FEWEST)]
    far = one("far", horizontal_rmse_m=40.0)
    bad = one("bad", horizontal_rmse_m=1.0, verdict="bad")
    other = one("other", horizontal_rmse_m=40.0, reference="autopilot")
    order = ranked([*usual, bad, other, far])
    assert [found.outcome.log for found in order[:2]] == ["far", "bad"]
    assert order[0].words[0].startswith("horizontal error 40 m (median 1.1")
    # A single difference from an autopilot has nothing to be held against, and too few have none.
    assert not any(found.words for found in order[1:])
    assert not any(found.words for found in ranked([*usual[: FEWEST - 2], far]))
