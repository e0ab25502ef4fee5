"""``njit`` for our kernels: found or compiled when first needed, kept by content.

Numba takes a kernel with an explicit signature from its cache, or compiles it, when its module is
imported, one after the other, though most are called from within others only, whose machine code
holds theirs. A kernel here is loaded when Python first calls it, and is a part of what calls it
otherwise (:mod:`companion._machine_code`). Whoever must not wait in flight loads what it needs
beforehand (:mod:`replay.kernels`). How code is told apart: :mod:`companion._kernel_cache`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, ParamSpec, TypeVar, cast

from companion import _kernel_cache

_BLAS = "scipy.linalg.cython_blas"

Given = ParamSpec("Given")
Result = TypeVar("Result")

made: list[Kernel[Any, Any]] = []
"""Every kernel of the modules imported so far, called ones before their callers."""
waits: list[Callable[[], None]] = []
"""Told when a kernel has to be compiled: who called for it has to wait for seconds."""


class Kernel(Generic[Given, Result]):
    """A jitted function of one signature; other kernels may call it, and so may Python."""

    def __init__(
        self,
        function: Callable[Given, Result],
        signature: str,
        *,
        cached: bool = True,
        counted: bool = True,
        entry: bool = False,
    ) -> None:
        update_wrapper(self, function)
        self._function, self._signature, self._cached = function, signature, cached
        self._counted = counted
        self.entry = entry
        self._machine: Any = None
        self._part: Any = None

    @property
    def stored_name(self) -> str:
        """Module and name: what the folder of its machine code begins with."""
        return f"{self._function.__module__}.{self._function.__qualname__}"

    @cached_property
    def kernel_key(self) -> str:
        """Hash of all that its machine code is made of."""
        how = self._signature if self._counted else f"{self._signature} uncounted"
        return _kernel_cache.key(self._function, how)

    @property
    def calls(self) -> tuple[Kernel[..., Any], ...]:
        """The kernels that this one calls."""
        found = (value for _, value in _kernel_cache.read_globals(self._function))
        return tuple(value for value in found if isinstance(value, Kernel))

    @property
    def ready(self) -> bool:
        """Whether nothing has to be compiled for a call; decided without numba."""
        return self._machine is not None or _kernel_cache.stored(self._home())

    def _home(self, form: str = "") -> Path:
        return _kernel_cache.home(f"{self.stored_name}{form}", self.kernel_key)

    def load(self) -> Any:
        """Numba's dispatcher, its code read from the cache, or compiled into it."""
        if self._machine is None:
            if waits and not self.ready:
                for tell in waits:
                    tell()
            with _without_blas():
                from companion._machine_code import machine_code

                home = self._home() if self._cached else None
                self._machine = machine_code(self._function, self._signature, self._counted, home)
        return self._machine

    def part(self) -> Any:
        """Numba's dispatcher for compiling callers, read from the cache, or compiled into it."""
        if self._part is None:
            with _without_blas():
                from companion._machine_code import part

                home = self._home(".part") if self._cached else None
                self._part = part(self._function, self._signature, self._counted, home)
        return self._part

    def __call__(self, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        result: Result = (self._machine or self.load())(*args, **kwargs)
        return result

    def __getattr__(self, name: str) -> Any:
        # What numba asks of a name in a kernel that it compiles: `_numba_type_` and others.
        if name in ("_machine", "_part", "_function"):
            raise AttributeError(name)
        return getattr(self.part(), name)


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


def njit(
    signature: str, *, cache: bool, counted: bool = True, entry: bool = False
) -> Callable[[Callable[Given, Result]], Kernel[Given, Result]]:
    """As ``numba.njit`` with a signature, loaded when first needed.

    ``counted`` false, for what runs at every sample: nobody counts who holds an array. Numba counts
    with atomic instructions at every view, slice and argument, which were a third of the walk; a
    kernel without it can make no array of its own, and gets its scratch handed in. ``entry``: our
    program calls it from Python too, and so it is compiled for that beforehand; the others only
    where somebody, such as a test, does it all the same.
    """

    def wrapped(function: Callable[Given, Result]) -> Kernel[Given, Result]:
        kernel = Kernel(function, signature, cached=cache, counted=counted, entry=entry)
        made.append(kernel)
        return kernel

    return wrapped
