"""The source cache: correct sources, of this package's kernels only, and only as long as the functions exist."""

import ast
import gc
import importlib.util
import inspect
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import taichi as ti
from taichi.lang import _wrap_inspect, kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

from taichi_cloth.system import taichi_compat as source_cache
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.taichi_compat import SourceCache


@pytest.fixture
def module(tmp_path: Path) -> Callable[[str], ModuleType]:
    """module(text): a module of this package, as imported or as reloaded by an editor."""

    def load(text: str, name: str = "taichi_cloth.edited") -> ModuleType:
        path = tmp_path / "edited.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        made = importlib.util.module_from_spec(spec)
        exec(compile(text, path, "exec"), made.__dict__)  # the loader would use the first text from __pycache__
        return made

    return load


def test_a_cached_source_is_not_looked_up_again(module: Callable[[str], ModuleType]) -> None:
    cache = SourceCache(inspect.getsourcelines)
    function = module("def f():\n    return 1\n").f
    for _ in range(3):
        assert cache(function) == (["def f():\n", "    return 1\n"], 1)
    assert (cache.hits, cache.misses) == (2, 1)


def test_code_replaced_by_an_editor_is_read_again(module: Callable[[str], ModuleType]) -> None:
    function = module("def f():\n    return 1\n").f
    assert kernel_impl.getsourcelines(function)[0] == ["def f():\n", "    return 1\n"]
    function.__code__ = module("# a line more\ndef f():\n    return 2222\n").f.__code__  # as IPython's %autoreload does
    assert kernel_impl.getsourcelines(function) == (["def f():\n", "    return 2222\n"], 2)
    assert kernel_impl.getsourcelines(function) == _wrap_inspect.getsourcelines(function)


def test_a_kernel_with_a_replaced_function_runs_the_new_code(module: Callable[[str], ModuleType]) -> None:
    text = "import taichi as ti\ndef inner():\n    return {}\nfunction = ti.func(inner)\n"
    first = module(text.format(1))

    def result() -> int:
        function = first.function

        @ti.kernel
        def call() -> int:
            return function()

        return int(call())

    assert result() == 1
    first.inner.__code__ = module(text.format(2222)).inner.__code__
    assert result() == 2222


def test_functions_of_other_packages_are_not_cached(module: Callable[..., ModuleType]) -> None:
    calls: list[Any] = []

    def look_up(function: Any) -> Any:
        calls.append(function)
        return len(calls)

    cache = SourceCache(look_up)
    theirs = [module("def f(): pass\n", name).f for name in ("taichi_clothes", "notebook", "__main__")]
    for function in (*theirs, *theirs, len, SourceCache):
        cache(function)
    assert len(calls) == 8
    assert (cache.hits, cache.misses) == (0, 0)


def test_the_cache_keeps_no_function_alive(module: Callable[[str], ModuleType]) -> None:
    cache = SourceCache(inspect.getsourcefile)
    function = module("def f(): pass\n").f
    cache(function)
    gone = weakref.ref(function), weakref.ref(function.__code__)
    del function
    gc.collect()
    assert [reference() for reference in gone] == [None, None]


WRONG = """
import taichi as ti

@ti.func
def inner(x):
    y = x + 1
    return (y +
            missing)

@ti.kernel
def outer() -> int:
    return inner(1) + inner(2)
"""


def message(outer: Callable[[], object]) -> str:
    with pytest.raises(ti.TaichiCompilationError) as found:
        outer()
    return str(found.value)


@pytest.mark.parametrize("name", ["taichi_cloth.edited", "notebook"])
def test_compile_errors_show_the_same_lines(module: Callable[..., ModuleType], name: str) -> None:
    runtime.start()
    outer = module(WRONG, name).outer
    cached = [message(outer) for _ in range(2)]
    source_cache.restore_functions()
    assert cached == [message(outer)] * 2
    assert "            missing)\n" in cached[0]


def test_positions_are_composed_once(module: Callable[..., ModuleType]) -> None:
    composed: list[Any] = []

    def describe(context: Any, node: Any) -> str:
        composed.append(node)
        return f"line {node.lineno}"

    cache = source_cache.PositionCache(describe)
    first, other = ast.parse("a + b\nc").body
    function = module("def f(): pass\n").f
    context = SimpleNamespace(func=SimpleNamespace(func=function))
    assert [cache(context, node) for node in (first, other, first)] == ["line 1", "line 2", "line 1"]
    assert len(composed) == 2
    function.__code__ = module("def f(): return 1\n").f.__code__  # edited
    cache(context, first)
    assert len(composed) == 3
    theirs = SimpleNamespace(func=SimpleNamespace(func=module("def f(): pass\n", "notebook").f))
    for _ in range(2):
        cache(theirs, first)
    assert len(composed) == 5


def test_stop_restores_taichi() -> None:
    runtime.stop()
    places = [
        (kernel_impl, "getsourcefile"),
        (kernel_impl, "getsourcelines"),
        (ASTTransformerContext, "get_pos_info"),
    ]
    usual = [getattr(*place) for place in places]
    assert usual[:2] == [_wrap_inspect.getsourcefile, _wrap_inspect.getsourcelines]
    for _ in range(2):
        runtime.start()
        source_cache.install_source_cache()
        assert not {id(getattr(*place)) for place in places} & set(map(id, usual))
        runtime.stop()
        assert [getattr(*place) for place in places] == usual
    runtime.start()
