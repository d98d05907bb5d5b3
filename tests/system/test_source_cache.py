"""The parser of kernels: sources are correct, cached for this package only; trees are parsed once and left clean."""

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
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext, Builder

from taichi_cloth.system import kernel_parsing
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.kernel_parsing import SourceCache, SyntaxTrees


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


CLASS = """
import taichi as ti

@ti.data_oriented
class Counter:
    @ti.kernel
    def three(self) -> int:
        return 3
"""


@pytest.mark.parametrize(("name", "calls"), [("notebook", 1), ("taichi_cloth.edited", 0)])
def test_taichi_itself_finds_the_classes_of_users(
    module: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch, name: str, calls: int
) -> None:
    """Their files may have changed since they were read."""
    kernel_parsing.restore_functions()
    usual, asked = kernel_impl._inside_class, []

    def inside_class(level: int) -> bool:
        asked.append(level)
        return bool(usual(level + 1))

    monkeypatch.setattr(kernel_impl, "_inside_class", inside_class)
    try:
        kernel_parsing.replace_class_check()
        assert module(CLASS, name).Counter().three() == 3
        assert len(asked) == calls
    finally:
        kernel_parsing.restore_functions()
        monkeypatch.undo()
        kernel_parsing.replace_class_check()
        kernel_parsing.replace_parser()


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
    kernel_parsing.restore_functions()
    assert cached == [message(outer)] * 2
    assert "            missing)\n" in cached[0]


def test_unsupported_nodes_are_refused_in_the_same_words(module: Callable[..., ModuleType]) -> None:
    runtime.start()
    text = (
        "import taichi as ti\n@ti.kernel\ndef outer() -> int:\n    try:\n        a = 1\n    finally:\n        a = 2\n"
    )
    outer = module(text).outer
    cached = message(outer)
    kernel_parsing.restore_functions()
    assert cached == message(outer)
    assert 'Unsupported node "Try"' in cached


def nodes(tree: ast.AST) -> list[dict[str, Any]]:
    return [dict(vars(node)) for node in ast.walk(tree)]


def test_a_tree_is_parsed_once_and_given_out_clean(module: Callable[[str], ModuleType]) -> None:
    runtime.start()
    trees, text = SyntaxTrees(), "@marked\ndef f():\n    return a.b + 1\n"
    context = SimpleNamespace(func=SimpleNamespace(func=module("def f(): pass\n").f), file="f.py", lineno_offset=6)
    tree = trees.parse(text)
    clean = nodes(tree)
    assert ast.dump(tree) == ast.dump(ast.parse(text))
    assert trees.parse(text) is not tree  # that one is in use

    def transform(tree: Any, context: Any) -> str:
        tree.body[0].decorator_list = []
        for node in ast.walk(tree):
            node.ptr = object()  # type: ignore[attr-defined]
        if context.file == "wrong.py":
            raise ValueError("wrong")
        info: str = ti.lang.impl.get_runtime().get_current_src_info()
        return info

    assert trees.transform(transform, tree, context) == 'File "f.py", line 7, in f:\n'
    assert context.is_brief
    assert nodes(tree) == clean
    assert trees.parse(text) is tree
    context.file = "wrong.py"
    with pytest.raises(ValueError, match="wrong"):
        trees.transform(transform, tree, context)
    assert nodes(tree) == clean
    assert trees.parse(text) is tree


RECURSIVE = """
import taichi as ti

@ti.func
def factorial(n: ti.template()):
    result = 1
    if ti.static(n > 1):
        result = n * factorial(n - 1) + 0 * factorial(1)
    return result

@ti.kernel
def outer(n: ti.template()) -> int:
    return factorial(n)
"""


def test_a_function_that_inlines_itself_has_a_tree_for_each_call(module: Callable[..., ModuleType]) -> None:
    runtime.start()
    outer = module(RECURSIVE).outer
    assert [outer(n) for n in (1, 4, 3, 5)] == [1, 24, 6, 120]


def test_kernels_leave_nothing_in_their_trees(module: Callable[..., ModuleType]) -> None:
    runtime.start()
    field = ti.field(int, 3)
    text = (
        "import taichi as ti\n@ti.func\ndef inner(x: ti.template(), i):\n    return x[i] + 1\n"
        "@ti.kernel\ndef outer(x: ti.template()):\n    for i in x:\n        x[i] = inner(x, i)\n"
    )
    module(text).outer(field)
    assert field.to_numpy().tolist() == [1, 1, 1]
    trees = kernel_parsing._trees
    assert not trees._used
    free = [tree for same in trees._free.values() for tree in same]
    assert any("outer" in ast.dump(tree) for tree in free)
    assert not [node for tree in free for node in nodes(tree) if {"ptr", "caller"} & node.keys()]


def test_trees_of_users_are_not_kept(module: Callable[..., ModuleType]) -> None:
    runtime.start()
    text = "import taichi as ti\n@ti.kernel\ndef theirs() -> int:\n    return 1 + 2 + 4\n"
    trees = kernel_parsing._trees
    count = len(trees._parsed)
    theirs = module(text, "notebook").theirs
    assert theirs() == 7
    assert len(trees._parsed) == count
    assert not trees._used
    assert not [tree for same in trees._free.values() for tree in same if "theirs" in ast.dump(tree)]


def test_positions_are_composed_once_for_each_function(module: Callable[..., ModuleType]) -> None:
    composed: list[Any] = []

    def describe(context: Any, node: Any) -> str:
        composed.append(node)
        return f"line {node.lineno}"

    position = kernel_parsing._positions(describe)
    first, other = ast.parse("a + b\nc").body
    ours = module("def f(): pass\n").f
    context, another = (SimpleNamespace(func=SimpleNamespace(func=ours)) for _ in range(2))
    assert [position(context, node) for node in (first, other, first)] == ["line 1", "line 2", "line 1"]
    assert len(composed) == 2
    position(another, first)
    assert len(composed) == 3
    of_user = SimpleNamespace(func=SimpleNamespace(func=module("def f(): pass\n", "notebook").f))
    for _ in range(2):  # the tree of a user's function is not kept, and another one may have its nodes' ids
        position(of_user, first)
    assert len(composed) == 5


def test_positions_are_composed_for_functions_of_users_and_in_debug_mode(
    module: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of users each time, because their trees are not kept."""
    described: list[Any] = []

    def describe(context: Any, node: Any) -> str:
        described.append(node)
        return ""

    monkeypatch.setattr(ASTTransformerContext, "get_pos_info", describe)
    text = "import taichi as ti\n@ti.kernel\ndef outer() -> int:\n    return 1 + 2\n"
    composed: list[bool] = []
    for debug, name in ((False, "taichi_cloth.edited"), (False, "notebook"), (True, "taichi_cloth.edited")):
        kernel_parsing.restore_functions()
        monkeypatch.setattr(ASTTransformerContext, "get_pos_info", describe)
        runtime.start(debug=debug)
        outer = module(text, name).outer
        described.clear()
        assert outer() == 3
        composed.append(len(described) > 1)
    runtime.stop()
    monkeypatch.undo()
    runtime.start()
    assert composed == [False, True, True]


def test_stop_restores_taichi() -> None:
    runtime.stop()
    places = [
        (kernel_impl, "getsourcefile"),
        (kernel_impl, "getsourcelines"),
        (kernel_impl, "textwrap"),
        (kernel_impl, "ast"),
        (kernel_impl, "transform_tree"),
        (Builder, "__call__"),
        (ASTTransformerContext, "get_pos_info"),
    ]
    usual = [getattr(*place) for place in places]
    assert usual[:2] == [_wrap_inspect.getsourcefile, _wrap_inspect.getsourcelines]
    for _ in range(2):
        runtime.start()
        kernel_parsing.replace_parser()
        assert not {id(getattr(*place)) for place in places} & set(map(id, usual))
        runtime.stop()
        assert [getattr(*place) for place in places] == usual
    runtime.start()
