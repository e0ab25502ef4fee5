"""Numba's side of a kernel: what Python calls, and the parts that it is made of.

What Python calls is optimised and turned into machine code, with a wrapper that unpacks its
arguments. What only kernels call needs none of that: it is optimised in its callers, inlined there,
up to the one that Python calls. Numba would do all of it at every level. A *part* here stays as
LLVM has it before its optimiser, and costs its typing and lowering alone.

Both are kept on disk by content (:mod:`companion._kernel_cache`). Of numba's names in this file
``njit`` and ``pipeline_class`` are public; ``tests/test_kernels.py`` fails if another goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, codegen, compiler

from companion import _kernel_cache

Function = Callable[..., Any]


def machine_code(function: Function, signature: str, counted: bool, home: Path | None) -> Any:
    """Numba's dispatcher of ``function``, to be called; kept in ``home``, or not at all."""
    how: dict[str, Any] = {"_nrt": counted, "no_cfunc_wrapper": True}
    made: Any = numba.njit(**how)(function)
    if home is not None:
        made._cache = _cache(function, home, caching.CompileResultCacheImpl)
    made.compile(signature)
    for result in made.overloads.values():
        # The parts' environments (to raise errors with) were unknown to the linker until now.
        for env in result._find_referenced_environments():
            result.library.codegen.set_env(env.env_name, env)
    made.disable_compile()
    return made


def part(function: Function, signature: str, counted: bool, home: Path | None) -> Any:
    """Numba's dispatcher of ``function``, to compile callers with; a call of it would crash."""
    how: dict[str, Any] = {"_nrt": counted, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
    made: Any = numba.njit(pipeline_class=_PartCompiler, **how)(function)
    if home is not None:
        made._cache = _cache(function, home, _KeptPart)
    made.compile(signature)
    made.disable_compile()
    return made


class _Part(codegen.JITCodeLibrary):
    """Code that is linked into that of its callers, and never run by itself."""

    @property
    def codegen(self) -> Any:
        return _NoEnvironments(self._codegen)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        return 0

    def serialize_using_object_code(self) -> Any:
        return self.serialize_using_bitcode()


class _NoEnvironments:
    """Numba's code generator, for code without an address to write an environment to."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def set_env(self, _name: str, _env: object) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


class _PartCompiler(compiler.Compiler):
    """Numba's compiler, into a :class:`_Part`."""

    def __init__(self, typing: Any, target: Any, library: Any, *given: Any) -> None:
        super().__init__(typing, target, library, *given)
        self.state.library = _Part(target.codegen(), "part")


class _KeptPart(caching.CompileResultCacheImpl):
    """Reads back what :class:`_Part` has written."""

    def rebuild(self, target: Any, payload: Any) -> Any:
        with _libraries_are_parts(target.codegen()):
            return super().rebuild(target, payload)


@contextmanager
def _libraries_are_parts(generator: Any) -> Iterator[None]:
    generator._library_class = _Part
    try:
        yield
    finally:
        del generator._library_class


def _cache(function: Function, home: Path, kind: type[caching.CompileResultCacheImpl]) -> Any:
    """Numba's own cache, told where by a path that says what is in it, with no time stamp."""

    class Place:
        _py_file = function.__code__.co_filename

        def get_cache_path(self) -> str:
            return str(home)

        def ensure_cache_path(self) -> None:
            home.mkdir(parents=True, exist_ok=True)
            _kernel_cache.forget_others(home)

        def get_source_stamp(self) -> str:
            return home.name

        def get_disambiguator(self) -> str:
            return "1"

        @classmethod
        def from_function(cls, *_: object) -> Place:
            return cls()

    class Kept(kind):  # type: ignore[valid-type,misc]  # one of two classes
        _locator_classes: Any = (Place,)

    class Cache(caching.FunctionCache):
        _impl_class = Kept

        def _guard_against_spurious_io_errors(self) -> Any:
            # A folder that cannot be written: compiled anew each time.
            return suppress(OSError)

    made_for: Any = Cache
    return made_for(function)
