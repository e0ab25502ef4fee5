"""``njit`` for our kernels: compiled before the first sample, loaded when first needed.

Numba takes a kernel with an explicit signature from its cache when its module is imported, one
after the other, though most are called from within others only, whose machine code holds theirs. On
a machine that has compiled them all (:func:`companion._kernel_cache.compiled`) a kernel here is
loaded when Python first calls it; a start loads a handful, and half a second sooner. Without that
mark every kernel compiles at the import of its module, as numba has it: callers after the called.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, update_wrapper
from types import ModuleType
from typing import Any, Generic, ParamSpec, TypeVar, cast

from companion import _kernel_cache

_BLAS = "scipy.linalg.cython_blas"

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Kernel(Generic[Given, Result]):
    """A jitted function of one signature; other kernels may call it, and so may Python."""

    def __init__(self, function: Callable[Given, Result], signature: str, cached: bool) -> None:
        update_wrapper(self, function)
        self._function, self._signature, self._cached = function, signature, cached
        self._machine: Any = None

    def load(self) -> Any:
        """Numba's dispatcher, its code read from the cache, or compiled into it."""
        if self._machine is None:
            with _without_blas():
                import numba

                self._machine = numba.njit(self._signature, cache=self._cached)(self._function)
        return self._machine

    def __call__(self, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        result: Result = (self._machine or self.load())(*args, **kwargs)
        return result

    def __getattr__(self, name: str) -> Any:
        # `_numba_type_` among others: what a kernel that calls this one is compiled with.
        if name == "_machine":
            raise AttributeError(name)
        return getattr(self.load(), name)


@contextmanager
def _without_blas() -> Iterator[None]:
    """Numba looks whether scipy has a BLAS when its first kernel loads, a quarter of a second.

    Ours may not use one (ADR 3). Who wants one later in the process is given it: numba looks again.
    """
    if _BLAS in sys.modules:
        yield
        return
    # What Python takes for a module that cannot be imported.
    sys.modules[_BLAS] = cast(ModuleType, None)
    try:
        yield
    finally:
        del sys.modules[_BLAS]


@cache
def _warm() -> bool:
    return _kernel_cache.compiled()


def njit(
    signature: str, *, cache: bool
) -> Callable[[Callable[Given, Result]], Kernel[Given, Result]]:
    """As ``numba.njit`` with a signature, loaded late where everything is compiled."""

    def made(function: Callable[Given, Result]) -> Kernel[Given, Result]:
        kernel = Kernel(function, signature, cache)
        if not _warm():
            kernel.load()
        return kernel

    return made
