"""Kernels' sources, looked up once: half the time and more of Taichi's reading of a kernel.

At each call that it inlines, hundreds in one frame, Taichi 1.7.4 looks through all modules and splits the file for the
lines of the function. For its error messages it wraps the line and a row of carets for every part of every expression,
60,000 times for one frame, though there are no more than 4,000 different ones. The messages stay the same.

This is for the functions of this package and of Taichi's: those of anybody else, who may edit them while the program
runs, are looked up as Taichi does it. An editor's reload, which gives a function other code, is noticed.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from functools import lru_cache
from types import CodeType, FunctionType
from typing import Any
from weakref import WeakKeyDictionary

from .kernels.internals import SOURCES, usable

OURS = ("taichi_cloth", "taichi")
MOST_LINES = 1 << 14  # wrapped lines that are remembered: 4 MB at most


class SourceCache:
    """A look-up that remembers what it found for a function, as long as the function is there and has the same code."""

    def __init__(self, look_up: Callable[[Any], Any]) -> None:
        self._look_up = look_up
        self._found: WeakKeyDictionary[FunctionType, tuple[CodeType, Any]] = WeakKeyDictionary()
        self.hits = self.misses = 0

    def __call__(self, function: Any) -> Any:
        if not isinstance(function, FunctionType) or function.__module__.partition(".")[0] not in OURS:
            return self._look_up(function)
        code, found = self._found.get(function, (None, None))
        if code is function.__code__:
            self.hits += 1
            return found
        self.misses += 1
        found = self._look_up(function)
        self._found[function] = function.__code__, found
        return found


class _Wrapper(textwrap.TextWrapper):
    """Remembers what it wrapped. Nobody may change its settings."""

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self._wrapped = lru_cache(MOST_LINES)(super().wrap)

    def wrap(self, text: str) -> list[str]:
        return list(self._wrapped(text))


_wrappers: dict[int, _Wrapper] = {}


def wrapper(*args: Any, **settings: Any) -> textwrap.TextWrapper:
    """In the place of `textwrap.TextWrapper`: one that remembers where only a width is given, else a new one."""
    if args or set(settings) != {"width"}:
        return textwrap.TextWrapper(*args, **settings)
    width = settings["width"]
    if width not in _wrappers:
        _wrappers[width] = _Wrapper(width)
    return _wrappers[width]


_replaced: list[tuple[Any, str, Any]] = []  # in which module, by what name, and what was there
_cache_of: dict[str, SourceCache] = {}  # by the look-up's name; what was found serves the next start too


def install() -> None:
    """Puts the caches into Taichi, if it has a place for them. Twice does no harm."""
    if _replaced or not usable(SOURCES):
        return
    from taichi.lang import kernel_impl
    from taichi.lang.ast import ast_transformer_utils

    for name in ("getsourcefile", "getsourcelines"):
        _replace(kernel_impl, name, _cache_of.setdefault(name, SourceCache(getattr(kernel_impl, name))))
    _replace(ast_transformer_utils, "TextWrapper", wrapper)


def _replace(module: Any, name: str, cached: Any) -> None:
    _replaced.append((module, name, getattr(module, name)))
    setattr(module, name, cached)


def lookups() -> tuple[int, int]:
    """How often lines of a function were known already, and how often not."""
    cache = _cache_of["getsourcelines"]
    return cache.hits, cache.misses


def remove() -> None:
    """Puts back what was there. Twice does no harm."""
    while _replaced:
        setattr(*_replaced.pop())
