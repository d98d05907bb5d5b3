"""Groups of Taichi fields that are used again instead of being made anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from ..kernels.whole import placed
from .program import ProgramRef

Fields = TypeVar("Fields")


def capacity(count: int) -> int:
    """The power of two that holds `count`, at least 16: few sizes serve all cloths."""
    return max(16, 1 << (count - 1).bit_length())


class Pool(Generic[Fields]):
    """Hands out groups of fields by size, and keeps those given back for the next one who asks.

    Taichi holds 512 field trees in a process, never frees the kernels compiled for one, and crashes on the
    touch of a destroyed one; fields that are used again have none of these troubles, and the kernels
    compiled for them are at hand at once.
    """

    def __init__(self, make: Callable[..., Fields]) -> None:
        self._make = make
        self._free: dict[tuple[int, ...], list[Fields]] = {}
        self._size: dict[int, tuple[int, ...]] = {}  # of each group handed out, by its identity
        self._program: ProgramRef | None = None  # a strong reference would let an ended program live on

    def take(self, *counts: int) -> Fields:
        """A group whose capacities hold these counts: `make(*capacities)`, or one that was given back."""
        if self._program is None or not self._program.runs():  # Taichi was started anew: the old fields are gone
            self._free.clear()
            self._size.clear()
            self._program = ProgramRef()
        size = tuple(capacity(count) for count in counts)
        shelf = self._free.setdefault(size, [])
        fields = shelf.pop() if shelf else self._make(*size)
        self._size[id(fields)] = size
        return fields

    def give_back(self, fields: Fields) -> None:
        """Puts a group on the shelf. One that Taichi's restart has ended is dropped."""
        size = self._size.pop(id(fields), None)
        if size is not None and self._program is not None and self._program.runs():
            self._free[size].append(fields)


def attached(owner: Any, name: str, make: Callable[[], Fields]) -> Fields:
    """More fields of a pooled group, made when first asked for: they are used again with it, like their kernels."""
    if not hasattr(owner, name):
        setattr(owner, name, placed(make) if owner.in_lanes else make())
    fields: Fields = getattr(owner, name)
    return fields
