"""The first start on a machine compiles kernels, and says so; later ones find them."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from companion import _kernel_cache as cache
from companion.cli import main
from replay import kernels


@pytest.fixture
def empty(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    # Their kernels from the cache in use until now, which numba asks for when it is imported.
    importlib.import_module("numba")
    importlib.import_module("replay.session")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.usefixtures("empty")
def test_an_empty_cache_is_cold_until_everything_was_compiled() -> None:
    assert not kernels.compiled()
    cache.note_compiled()
    assert kernels.compiled()


def test_a_mark_of_other_sources_or_versions_is_cold(empty: Path) -> None:
    cache.note_compiled()
    (mark,) = empty.iterdir()
    mark.write_text(mark.read_text().replace("numba ", "numba 0."))
    assert not kernels.compiled()


def test_a_cache_that_cannot_be_written_stays_cold(empty: Path) -> None:
    empty.write_text("a file where the folder would be")
    cache.note_compiled()
    assert not kernels.compiled()


def test_every_module_with_a_kernel_is_loaded_called_before_caller(root: Path) -> None:
    names = kernels.kernel_modules()
    assert names.index("companion.navigation.mechanisation") < names.index(
        "companion.estimation.walk"
    )
    with_kernels = {
        ".".join(path.relative_to(root).with_suffix("").parts)
        for package in ("companion", "drivers", "replay")
        for path in (root / package).rglob("*.py")
        if "\n@njit" in path.read_text(encoding="utf-8")
    }
    assert with_kernels - set(names) == {"replay.bench.floor"}


def test_asking_does_not_import_numba(root: Path) -> None:
    code = (
        "import sys; from replay import kernels; kernels.compiled(); print('numba' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


@pytest.mark.usefixtures("empty")
def test_first_start_says_that_it_compiles_once_before_it_does(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    sample_flight: Path,
) -> None:
    said: list[str] = []

    def load_all(_: object) -> float:
        said.append(capsys.readouterr().err)
        cache.note_compiled()
        return 0.0

    monkeypatch.setattr(kernels, "load_all", load_all)
    for _ in range(2):
        with pytest.raises(SystemExit, match="0"):
            main(["replay", str(sample_flight), "--out", str(tmp_path / "run.mcap")])
    assert len(said) == 1
    assert "compiling" in said[0]
    assert "once" in said[0]


@pytest.mark.usefixtures("empty")
def test_a_log_that_is_not_there_compiles_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(kernels, "load_all", lambda _: pytest.fail("compiled"))
    with pytest.raises(SystemExit, match="1"):
        main(["replay", str(tmp_path / "absent.tlog")])


def test_a_warm_start_loads_only_what_python_calls(root: Path) -> None:
    """Neither scipy's statistics nor its BLAS, and of the kernels a handful."""
    code = """
import sys
from pathlib import Path
from companion._jit import Kernel
made, loaded = [], []
load = Kernel.load
def counted(self):
    loaded.append(self.__name__)
    return load(self)
init = Kernel.__init__
def noted(self, *given):
    made.append(self)
    init(self, *given)
Kernel.load, Kernel.__init__ = counted, noted
from companion.config import load as load_config
from companion.runtime.start import warm_up
import companion.runtime.run
warm_up(load_config(Path("configs/multirotor.toml")))
heavy = [m for m in ("scipy.special", "scipy.linalg", "scipy.stats") if m in sys.modules]
print(len(made), len(set(loaded)), "walk" in loaded, heavy)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    made, loaded, walked, heavy = done.stdout.split(maxsplit=3)
    assert int(made) > 40
    assert int(loaded) < int(made) / 3
    assert (walked, heavy.strip()) == ("True", "[]")
