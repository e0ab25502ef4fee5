"""What a kernel's machine code is known by, where it is kept, and what a first start says."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType

import msgspec
import pytest

from companion import _jit
from companion import _kernel_cache as cache
from companion.cli import main
from companion.cli.commands import compile_kernels
from companion.config import Config
from companion.navigation import layout
from replay import kernels

SIGNATURE = "f8(f8)"
SCALE = 2.0


def _called(x: float) -> float:
    return x * SCALE


def _scaled(x: float) -> float:
    """Its documentation."""
    return float(called(x)) + 1.0


def kernel_of(function: Callable[..., float]) -> _jit.Kernel[..., float]:
    """As where a module is imported: nothing loaded."""
    return _jit.Kernel(function, SIGNATURE, entry=True)


called = kernel_of(_called)


def again(function: Callable[..., object], **others: object) -> str:
    """The key of the same code where some globals are others."""
    assert isinstance(function, FunctionType)
    seen = {**function.__globals__, **others}
    return cache.key(FunctionType(function.__code__, seen), SIGNATURE)


def test_the_key_follows_values_and_called_kernels_and_no_comment() -> None:
    own = cache.key(_called, SIGNATURE)
    assert again(_called) == own
    assert again(_called, SCALE=2.0000000000000004) != own
    assert cache.key(_called, "f4(f4)") != own
    caller = cache.key(_scaled, SIGNATURE)
    other = FunctionType(_called.__code__, {**_called.__globals__, "SCALE": 3.0})
    assert again(_scaled, called=kernel_of(other)) != caller
    undocumented = _scaled.__code__.replace(
        co_consts=tuple(None if c == _scaled.__doc__ else c for c in _scaled.__code__.co_consts)
    )
    bare = FunctionType(undocumented, _scaled.__globals__)
    assert cache.key(bare, SIGNATURE) == caller


def _offset(x: float) -> float:
    return x + layout.HEIGHT


def test_the_key_follows_constants_of_our_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    before = cache.key(_offset, SIGNATURE)
    monkeypatch.setattr(layout, "HEIGHT", layout.HEIGHT + 1)
    assert cache.key(_offset, SIGNATURE) != before


def test_a_global_whose_content_cannot_be_told_is_refused() -> None:
    with pytest.raises(TypeError, match="no name"):
        again(_called, SCALE=object())


@pytest.fixture
def empty(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    cache.folder.cache_clear()
    yield tmp_path / "cache"
    cache.folder.cache_clear()


def test_machine_code_is_kept_and_found_by_another(empty: Path) -> None:
    assert not kernel_of(_called).ready
    assert kernel_of(_called)(3.0) == 6.0
    assert kernel_of(_called).ready
    before = [(path, path.stat().st_mtime_ns) for path in empty.rglob("*.nbc")]
    assert kernel_of(_called)(3.0) == 6.0
    assert len(before) == 1
    assert [(path, path.stat().st_mtime_ns) for path in empty.rglob("*.nbc")] == before


def _refused(x: float) -> float:
    if x < 0.0:
        raise ValueError("below zero")
    return x


def _asks(x: float) -> float:
    return float(refused(x)) + float(called(x))


refused = _jit.Kernel(_refused, SIGNATURE)


def test_a_part_is_compiled_into_its_caller_and_kept(empty: Path) -> None:
    """The caller works from fresh parts, from parts that were kept, and when kept itself."""
    refused._part = called._part = None
    fresh = kernel_of(_asks)
    assert fresh(3.0) == 9.0
    with pytest.raises(ValueError, match="below zero"):
        fresh(-1.0)
    stored = sorted(path.parent.name.rpartition("-")[0] for path in empty.rglob("*.nbc"))
    mine = f"{__name__}."
    assert stored == [f"{mine}_asks", f"{mine}_called.part", f"{mine}_refused.part"]
    assert not refused.ready  # a part is not for Python; it can be made so
    assert kernel_of(_asks)(3.0) == 9.0
    shutil.rmtree(next(path.parent for path in empty.rglob("*_asks*.nbc")))
    refused._part = called._part = None
    again = kernel_of(_asks)
    assert again(3.0) == 9.0
    with pytest.raises(ValueError, match="below zero"):
        again(-1.0)
    assert refused(2.0) == 2.0


def _kernels_in(tree: ast.Module) -> dict[str, bool]:
    """Kernels of a module by name, and whether each is marked as called from Python."""
    found = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "njit":
                    found[node.name] = any(word.arg == "entry" for word in mark.keywords)
    return found


def _outside_kernels(node: ast.AST, own: dict[str, bool]) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.FunctionDef) and child.name in own):
            yield child
            yield from _outside_kernels(child, own)


def test_what_python_calls_is_compiled_before_it_does(root: Path) -> None:
    """Each kernel that plain code names is marked as an entry, and no other is."""
    trees = {
        ".".join(path.relative_to(root).with_suffix("").parts): ast.parse(path.read_bytes())
        for package in ("companion", "drivers", "replay")
        for path in (root / package).rglob("*.py")
        if path.parent.name != "proto"
    }
    of_module = {module: _kernels_in(tree) for module, tree in trees.items()}
    of_module = {module: own for module, own in of_module.items() if own}
    named: set[tuple[str, str]] = set()
    for module, tree in trees.items():
        own = of_module.get(module, {})
        kernel_names = {name: (module, name) for name in own}
        modules: dict[str, str] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    bound = alias.asname or alias.name
                    if alias.name in of_module.get(node.module, {}):
                        kernel_names[bound] = (node.module, alias.name)
                    elif f"{node.module}.{alias.name}" in of_module:
                        modules[bound] = f"{node.module}.{alias.name}"
        for node in _outside_kernels(tree, own):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                if node.id in kernel_names:
                    named.add(kernel_names[node.id])
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                inside = modules.get(node.value.id, "")
                if node.attr in of_module.get(inside, {}):
                    named.add((inside, node.attr))
    marked = {(module, name) for module, own in of_module.items() for name in own if own[name]}
    assert marked == {one for one in named if one[0] != "replay.bench.floor"}


def test_a_folder_that_cannot_be_written_compiles_and_goes_on(empty: Path) -> None:
    empty.write_text("a file where the folder would be")
    assert kernel_of(_called)(3.0) == 6.0
    assert not kernel_of(_called).ready


def test_only_the_newest_stays_in_a_folder_of_our_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    for name in ("a.walk-1", "a.walk-2", "a.walks-1", "b.walk-1"):
        (tmp_path / name).mkdir()
    cache.forget_others(tmp_path / "a.walk-2")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.walk-2", "a.walks-1", "b.walk-1"]


def test_every_module_with_a_kernel_has_a_part(root: Path) -> None:
    modules = kernels.kernel_modules()
    parts = {module: kernels.part_of(module) for module in modules}
    assert parts["companion.estimation.direct.walk"] == "direct"
    assert parts["companion.estimation.walk"] == "filter"
    with_kernels = {
        ".".join(path.relative_to(root).with_suffix("").parts)
        for package in ("companion", "drivers", "replay")
        for path in (root / package).rglob("*.py")
        if "\n@njit" in path.read_text(encoding="utf-8")
    }
    assert with_kernels - set(modules) == {"replay.bench.floor"}


def test_asking_does_not_import_numba(root: Path) -> None:
    code = (
        "import sys; from replay import kernels; kernels.compiled('filter'); "
        "print('numba' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


@pytest.mark.usefixtures("empty")
def test_first_start_says_that_it_compiles_before_it_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kernel = kernel_of(_called)
    said: list[str] = []
    load = kernel.load

    def noted() -> object:
        said.append(capsys.readouterr().err)
        return load()

    monkeypatch.setattr(kernel, "load", noted)
    monkeypatch.setattr(kernels, "kernels_of", lambda _: [kernel])
    for _ in range(2):
        compile_kernels(["filter"])
    assert len(said) == 1
    assert "compiling" in said[0]
    assert "once" in said[0]


@pytest.mark.usefixtures("empty")
def test_what_compiles_later_is_said_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kernels, "kernels_of", lambda _: [])
    compile_kernels([])
    assert kernel_of(_called)(1.0) + kernel_of(_offset)(1.0) == 3.0 + layout.HEIGHT
    assert capsys.readouterr().err.count("further kernels") == 1


def test_a_log_that_is_not_there_compiles_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(kernels, "load", lambda *_: pytest.fail("compiled"))
    monkeypatch.setattr(kernels, "compiled", lambda *_: False)
    with pytest.raises(SystemExit, match="1"):
        main(["replay", str(tmp_path / "absent.tlog")])


def test_a_run_loads_the_parts_that_it_may_call() -> None:
    config = Config()
    assert kernels.parts_of(config) == ("filter",)
    smoothing = msgspec.structs.replace(config.smoothing, enabled=True)
    raw = msgspec.structs.replace(config.raw_gnss, coupling="tight")
    asked = msgspec.structs.replace(config, smoothing=smoothing, raw_gnss=raw)
    assert kernels.parts_of(asked) == ("filter", "smoothing", "gnss")


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
def noted(self, *given, **said):
    made.append(self)
    init(self, *given, **said)
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
