"""Sources that are looked up once: the right ones, of our own kernels only, and for no longer than these live."""

import gc
import importlib.util
import inspect
import textwrap
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import taichi as ti
from taichi.lang import _wrap_inspect, kernel_impl
from taichi.lang.ast import ast_transformer_utils

from taichi_cloth import runtime, source_cache
from taichi_cloth.source_cache import SourceCache


@pytest.fixture
def module(tmp_path: Path) -> Callable[[str], ModuleType]:
    """module(text): a module of our package, or what an editor's reload makes of it."""

    def load(text: str, name: str = "taichi_cloth.edited") -> ModuleType:
        path = tmp_path / "edited.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        made = importlib.util.module_from_spec(spec)
        exec(compile(text, path, "exec"), made.__dict__)  # the loader would take the first text's from __pycache__
        return made

    return load


def test_what_is_known_is_not_looked_up_again(module: Callable[[str], ModuleType]) -> None:
    cache = SourceCache(inspect.getsourcelines)
    function = module("def f():\n    return 1\n").f
    for _ in range(3):
        assert cache(function) == (["def f():\n", "    return 1\n"], 1)
    assert (cache.hits, cache.misses) == (2, 1)


def test_code_that_an_editor_replaces_is_read_anew(module: Callable[[str], ModuleType]) -> None:
    function = module("def f():\n    return 1\n").f
    assert kernel_impl.getsourcelines(function)[0] == ["def f():\n", "    return 1\n"]
    function.__code__ = module("# a line more\ndef f():\n    return 2222\n").f.__code__  # as IPython's %autoreload does
    assert kernel_impl.getsourcelines(function) == (["def f():\n", "    return 2222\n"], 2)
    assert kernel_impl.getsourcelines(function) == _wrap_inspect.getsourcelines(function)


def test_a_kernel_whose_function_is_replaced_runs_what_it_says(module: Callable[[str], ModuleType]) -> None:
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


def test_functions_of_others_are_looked_up_as_taichi_does(module: Callable[..., ModuleType]) -> None:
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


def test_nothing_is_kept_alive(module: Callable[[str], ModuleType]) -> None:
    cache = SourceCache(inspect.getsourcefile)
    function = module("def f(): pass\n").f
    cache(function)
    gone = weakref.ref(function), weakref.ref(function.__code__)
    del function
    gc.collect()
    assert [reference() for reference in gone] == [None, None]


TEXTS = ["a line  with   spaces", "x" * 200, " " * 100 + "^" * 20, "", "\tone and another " * 20, "a-b " * 60]


def test_lines_are_wrapped_as_ever() -> None:
    for _ in range(2):
        for text in TEXTS:
            assert source_cache.wrapper(width=80).wrap(text) == textwrap.TextWrapper(width=80).wrap(text)
            assert source_cache.wrapper(width=80).fill(text) == textwrap.TextWrapper(width=80).fill(text)
    source_cache.wrapper(width=80).wrap("one two").append("spoilt")
    assert source_cache.wrapper(width=80).wrap("one two") == ["one two"]


@pytest.mark.parametrize("given", [((20,), {}), ((), {"width": 20, "initial_indent": "> "}), ((), {})])
def test_a_wrapper_with_other_settings_is_the_usual_one(given: tuple[tuple[Any, ...], dict[str, Any]]) -> None:
    positional, named = given
    assert type(source_cache.wrapper(*positional, **named)) is textwrap.TextWrapper
    for text in TEXTS:
        usual = textwrap.TextWrapper(*positional, **named)
        assert source_cache.wrapper(*positional, **named).wrap(text) == usual.wrap(text)


def test_taichi_is_as_it_was_when_it_is_stopped() -> None:
    places = [(kernel_impl, "getsourcefile"), (kernel_impl, "getsourcelines"), (ast_transformer_utils, "TextWrapper")]
    usual = [_wrap_inspect.getsourcefile, _wrap_inspect.getsourcelines, textwrap.TextWrapper]
    for _ in range(2):
        runtime.start()
        source_cache.install()
        assert not {id(getattr(*place)) for place in places} & set(map(id, usual))
        runtime.stop()
        assert [getattr(*place) for place in places] == usual
    runtime.start()
