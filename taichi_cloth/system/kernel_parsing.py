"""Faster import and parsing of kernels, and serial loops: replaced functions of Taichi (`taichi_compat.py`).

The uses are the decorators of kernels (`DECORATORS`), the parser (`SOURCES`) and its loops (`LOOPS`).
"""

from __future__ import annotations

import ast
import linecache
import re
import sys
import textwrap
from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any
from weakref import WeakKeyDictionary

import taichi as ti

from .taichi_compat import InternalUse, parsed_correctly, usable

DECORATORS = InternalUse(
    ("lang.kernel_impl._inside_class", "lang.kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES"),
    "importing the kernels takes a third of a second longer",
)
SOURCES = InternalUse(
    (
        "lang.kernel_impl.getsourcefile",
        "lang.kernel_impl.getsourcelines",
        "lang.kernel_impl.textwrap",
        "lang.kernel_impl.ast",
        "lang.kernel_impl.transform_tree",
        "lang.ast.ast_transformer_utils.Builder.__call__",
        "lang.ast.ast_transformer_utils.ASTTransformerContext.get_pos_info",
    ),
    "startup takes a second longer",
)
LOOPS = InternalUse(
    (
        "lang.ast.ast_transformer.ASTTransformer.build_range_for",
        "lang.ast.ast_transformer.ASTTransformer.build_ndrange_for",
        "_lib.core.ASTBuilder.strictly_serialize",
    ),
    "each loop that could be parallel takes 0.1 ms longer",
)

USES_OF_PARSER = (SOURCES, LOOPS)  # a probe kernel is compiled for each

CACHED_PACKAGES = ("taichi_cloth", "taichi")  # packages whose sources are cached


class SourceCache:
    """A function that caches the results of a source look-up, as long as a function exists and has the same code.

    Look-ups take half or more of the time in which Taichi 1.7.4 parses a kernel. At each call that it inlines, hundreds
    per frame, it searches all modules and splits the file to find the lines of the function.

    Only functions of this package and of Taichi are cached. Others may be edited while the program runs and are looked
    up each time. A reload by an editor, which gives a function new code, is detected.
    """

    def __init__(self, look_up: Callable[[Any], Any]) -> None:
        self._look_up = look_up
        self._found: WeakKeyDictionary[FunctionType, tuple[CodeType, Any]] = WeakKeyDictionary()
        self.hits = self.misses = 0

    def __call__(self, function: Any) -> Any:
        if not is_cached(function):
            return self._look_up(function)
        code, found = self._found.get(function, (None, None))
        if code is function.__code__:
            self.hits += 1
            return found
        self.misses += 1
        found = self._look_up(function)
        self._found[function] = function.__code__, found
        return found


def is_cached(function: Any) -> bool:
    """Return whether the source of a function is cached."""
    return isinstance(function, FunctionType) and function.__module__.partition(".")[0] in CACHED_PACKAGES


class SyntaxTrees:
    """Parses sources as `ast.parse` does, each text once, and gives a tree out again after it was transformed.

    Taichi 1.7.4 parses a function at each call that it inlines. While it transforms the tree it stores what a node
    became in the node: `transform` removes that, so that nothing of a kernel outlives its compilation. A function of a
    user is parsed and transformed as Taichi does it, and its tree is not kept.
    """

    def __init__(self) -> None:
        self._free: dict[str, list[ast.Module]] = {}
        self._used: dict[int, tuple[str, ast.Module]] = {}  # by id of the tree
        self._parsed: dict[int, list[tuple[dict[str, Any], dict[str, Any]]]] = {}  # attributes of nodes, and a copy

    def parse(self, text: str) -> ast.Module:
        free = self._free.setdefault(text, [])
        tree = free.pop() if free else ast.parse(text)  # a function may inline itself
        if id(tree) not in self._parsed:
            self._parsed[id(tree)] = [(vars(node), dict(vars(node))) for node in ast.walk(tree)]
        self._used[id(tree)] = text, tree
        return tree

    def transform(self, transform: Callable[[Any, Any], Any], tree: ast.Module, context: Any) -> Any:
        """Call Taichi's `transform`; for functions of this package with messages of the compiler that name them."""
        text, _ = self._used.pop(id(tree))
        if not is_cached(context.func.func):
            del self._parsed[id(tree)]
            context.is_brief = False
            return transform(tree, context)
        context.is_brief = not ti.cfg.debug
        where = f'File "{context.file}", line {context.lineno_offset + 1}, in {context.func.func.__name__}:\n'
        try:
            with ti.lang.impl.get_runtime().src_info_guard(where):
                return transform(tree, context)
        finally:
            for attributes, parsed in self._parsed[id(tree)]:
                attributes.clear()
                attributes.update(parsed)
            self._free[text].append(tree)


class _Failed:
    """Stands for a builder whose every method raises an error."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def __getattr__(self, name: str) -> Callable[..., None]:
        def fail(*arguments: object) -> None:
            raise self._error

        return fail


def _brief(build: Callable[[Any, Any, Any], Any]) -> Callable[[Any, Any, Any], Any]:
    """Return a builder of syntax nodes that composes the position of a node only if it fails. `build`: that of Taichi.

    Taichi 1.7.4 composes it for every node, half a million times for the kernels of all solvers. It does so here for
    functions of users, and in debug mode, in which checks at run time print it.
    """
    methods: dict[type, Any] = {}

    def build_node(builder: Any, context: Any, node: Any) -> Any:
        kind = type(node)
        if kind not in methods:
            methods[kind] = getattr(builder, f"build_{kind.__name__}", None)
        if methods[kind] is None or not context.is_brief:
            return build(builder, context, node)
        try:
            return methods[kind](context, node)
        except Exception as error:  # Taichi adds the position
            return build(_Failed(error), context, node)

    return build_node


def _positions(describe: Callable[[Any, Any], str]) -> Callable[[Any, Any], str]:
    """Return a description of where a node is that is composed once for each node that `SyntaxTrees` keeps."""

    def position(context: Any, node: Any) -> str:
        if not is_cached(context.func.func):
            return describe(context, node)
        found: dict[int, str] = vars(context.func).setdefault("positions", {})
        if id(node) not in found:
            found[id(node)] = describe(context, node)
        return found[id(node)]

    return position


_cache_of: dict[str, SourceCache] = {}  # by name of the look-up; kept for the next start
_trees = SyntaxTrees()


def replace_parser() -> None:
    """Let Taichi parse kernels with the functions above, if `SOURCES` is usable. A second call has no effect."""
    _replace_if_usable(SOURCES, _replace_sources)


def _replace_sources() -> None:
    from taichi.lang import kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext, Builder

    for name in ("getsourcefile", "getsourcelines"):
        _replace(kernel_impl, name, partial(_source_cache, name))
    text = SimpleNamespace(fill=lru_cache(2**14)(textwrap.fill), dedent=lru_cache(2**10)(textwrap.dedent))
    _replace(kernel_impl, "textwrap", lambda _: text)
    _replace(kernel_impl, "ast", lambda _: SimpleNamespace(parse=_trees.parse))
    _replace(kernel_impl, "transform_tree", lambda transform: partial(_trees.transform, transform))
    _replace(Builder, "__call__", _brief)
    _replace(ASTTransformerContext, "get_pos_info", _positions)


def _source_cache(name: str, look_up: Callable[[Any], Any]) -> SourceCache:
    return _cache_of.setdefault(name, SourceCache(look_up))


def cache_hits_and_misses() -> tuple[int, int]:
    """Return the number of hits and misses of the cache of function lines."""
    cache = _cache_of["getsourcelines"]
    return cache.hits, cache.misses


# -- decorators --------------------------------------------------------------------------------------------------------


def replace_class_check() -> None:
    """Let `ti.func` and `ti.kernel` find out faster whether they stand in a class, if `DECORATORS` is usable.

    Taichi 1.7.4 searches all modules for the source of each decorated function, 340 times in this package. It still
    does so for functions of users, whose files may be edited while the program runs.
    """
    if usable(DECORATORS):
        from taichi.lang import kernel_impl

        patterns = kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES
        _replace(kernel_impl, "_inside_class", lambda usual: partial(_is_in_class, usual, patterns))


def _is_in_class(usual: Callable[[int], bool], patterns: list[re.Pattern[str]], level_of_class_stackframe: int) -> bool:
    """Return whether the line that runs in a frame of the stack matches a pattern. `usual`: the check of Taichi."""
    try:
        frame = sys._getframe(level_of_class_stackframe)
    except ValueError:  # a decorator at the top level of a script: no line of a class can be below it
        return False
    if str(frame.f_globals.get("__name__")).partition(".")[0] not in CACHED_PACKAGES:
        return usual(level_of_class_stackframe + 1)  # which stands one frame deeper
    line = linecache.getline(frame.f_code.co_filename, frame.f_lineno, frame.f_globals).strip()
    return any(pattern.match(line) for pattern in patterns)


# -- serial loops ------------------------------------------------------------------------------------------------------


def serialize_loops() -> None:
    """Compile every loop of this package's later kernels as a serial one, if `LOOPS` is usable.

    A second call has no effect. Kernels of users stay as they are. This is for Taichi on one thread. Its pool hands
    each parallel loop over to another thread even if that is the only one: two context switches of 0.1 ms together, and
    more where all cores are busy.
    """
    _replace_if_usable(LOOPS, _replace_loops)


def _replace_loops() -> None:
    from taichi.lang.ast.ast_transformer import ASTTransformer

    for name in ("build_range_for", "build_ndrange_for"):
        _replace(ASTTransformer, name, _serialized)


def _serialized(build: Any) -> Any:
    """Return a builder of loops that marks its loop as serial. `build`: that of Taichi, a static method."""

    def build_serial(context: Any, node: Any) -> Any:
        if is_cached(context.func.func):  # not a kernel of the user
            context.ast_builder.strictly_serialize()  # the next loop
        return build.__func__(context, node)

    return staticmethod(build_serial)


# -- replaced functions ------------------------------------------------------------------------------------------------

_replaced: dict[tuple[Any, str], Any] = {}  # the original, by module or class, and name


def _replace(owner: Any, name: str, substitute: Callable[[Any], Any]) -> None:
    """Replace a function of Taichi by what `substitute` returns for it, unless it is replaced already."""
    if (owner, name) not in _replaced:
        _replaced[owner, name] = vars(owner)[name]
        setattr(owner, name, substitute(vars(owner)[name]))


def _replace_if_usable(use: InternalUse, replace: Callable[[], None]) -> None:
    """Replace functions by `replace`, if a probe kernel that is compiled with them returns the right number."""
    before = set(_replaced)

    def probe() -> bool:
        replace()
        return parsed_correctly(USES_OF_PARSER.index(use))

    if usable(use, probe):
        replace()
    else:
        restore_functions(set(_replaced) - before)


def restore_functions(which: Iterable[tuple[Any, str]] | None = None) -> None:
    """Restore the original functions of Taichi, all or those named. A second call has no effect."""
    for owner, name in list(_replaced) if which is None else which:
        setattr(owner, name, _replaced.pop((owner, name)))
