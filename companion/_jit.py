"""``njit`` for our kernels: found or compiled when first needed, kept by content.

Numba takes a kernel with an explicit signature from its cache, or compiles it, when its module is
imported, one after the other, though most are called from within others only, whose machine code
holds theirs. A kernel here is loaded when Python first calls it, or when another that calls it has
to be compiled. Whoever must not wait in flight loads what it needs beforehand
(:mod:`replay.kernels`). How the machine code is told apart: :mod:`companion._kernel_cache`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, update_wrapper
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
        self, function: Callable[Given, Result], signature: str, cached: bool, counted: bool
    ) -> None:
        update_wrapper(self, function)
        self._function, self._signature, self._cached = function, signature, cached
        self._counted = counted
        self._machine: Any = None

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
    def ready(self) -> bool:
        """Whether nothing has to be compiled for a call; decided without numba."""
        return self._machine is not None or _kernel_cache.stored(self.stored_name, self.kernel_key)

    def load(self) -> Any:
        """Numba's dispatcher, its code read from the cache, or compiled into it."""
        if self._machine is None:
            if waits and not self.ready:
                for tell in waits:
                    tell()
            with _without_blas():
                import numba

                # Said in either case: numba hands it down to what it has to compile meanwhile.
                how: dict[str, Any] = {"_nrt": self._counted}
                machine: Any = numba.njit(**how)(self._function)
                if self._cached:
                    machine._cache = _kept(self)
                machine.compile(self._signature)
                machine.disable_compile()
                self._machine = machine
        return self._machine

    def __call__(self, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        result: Result = (self._machine or self.load())(*args, **kwargs)
        return result

    def __getattr__(self, name: str) -> Any:
        # `_numba_type_` among others: what a kernel that calls this one is compiled with.
        if name in ("_machine", "_function"):
            raise AttributeError(name)
        return getattr(self.load(), name)


def _kept(kernel: Kernel[Any, Any]) -> Any:
    """Numba's own cache of machine code, told where and by what key instead of by a time stamp."""
    from numba.core import caching

    home = _kernel_cache.home(kernel.stored_name, kernel.kernel_key)

    class Place:
        _py_file = kernel.__wrapped__.__code__.co_filename

        def get_cache_path(self) -> str:
            return str(home)

        def ensure_cache_path(self) -> None:
            home.mkdir(parents=True, exist_ok=True)
            _kernel_cache.forget_others(kernel.stored_name, kernel.kernel_key)

        def get_source_stamp(self) -> str:
            return kernel.kernel_key

        def get_disambiguator(self) -> str:
            return "1"

        @classmethod
        def from_function(cls, *_: object) -> Place:
            return cls()

    class Kept(caching.CompileResultCacheImpl):
        _locator_classes: Any = (Place,)

    class Cache(caching.FunctionCache):
        _impl_class = Kept

        def _guard_against_spurious_io_errors(self) -> Any:
            # A folder that cannot be written: compiled anew each time.
            return suppress(OSError)

    made_for: Any = Cache
    return made_for(kernel.__wrapped__)


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
    signature: str, *, cache: bool, counted: bool = True
) -> Callable[[Callable[Given, Result]], Kernel[Given, Result]]:
    """As ``numba.njit`` with a signature, loaded when first needed.

    ``counted`` false, for what runs at every sample: nobody counts who holds an array. Numba counts
    with atomic instructions at every view, slice and argument, which were a third of the walk; a
    kernel without it can make no array of its own, and gets its scratch handed in.
    """

    def wrapped(function: Callable[Given, Result]) -> Kernel[Given, Result]:
        kernel = Kernel(function, signature, cache, counted)
        made.append(kernel)
        return kernel

    return wrapped
