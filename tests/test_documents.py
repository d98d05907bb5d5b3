"""Links, paths, names, commands and generated blocks of the documents are correct."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
import shutil
import string
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from chromium import Browser, chromium

import taichi_cloth as tc
from taichi_cloth.cli import output_commands, run, scenes
from taichi_cloth.cli.program import build_parser, overrides
from taichi_cloth.evaluation import commands as evaluation_commands
from taichi_cloth.evaluation import compare
from taichi_cloth.render.image_files import write_png
from taichi_cloth.scene import key_table
from taichi_cloth.scene.fabric_schema import PRESET_NAMES
from taichi_cloth.scene.schema import SOLVER_NAMES, sections

TOP = Path(__file__).parents[1]
DOCS = TOP / "docs"
DOCUMENTS = [*TOP.glob("*.md"), *DOCS.rglob("*.md")]
LINK = re.compile(r"\]\(([^)#]+)[^)]*\)")
ANCHOR = re.compile(r"\]\(([^)#]*)#([^)]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
MODULES = (run, compare, output_commands, scenes, evaluation_commands)  # as in `taichi_cloth.__main__`


def text_of(document: Path) -> str:
    return document.read_text(encoding="utf-8")


def name_of(document: Path) -> str:
    return document.relative_to(TOP).as_posix()


def blocks(document: Path, language: str) -> list[str]:
    return re.findall(rf"^ *```{language}\n(.*?)```", text_of(document), re.DOTALL | re.MULTILINE)


def each(documents: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("document", documents, ids=name_of)


# -- links and paths ---------------------------------------------------------------------------------------------------


@each(DOCUMENTS)
def test_linked_files_exist(document: Path) -> None:
    targets = [link for link in LINK.findall(text_of(document)) if "://" not in link]
    assert [link for link in targets if not (document.parent / link).exists()] == []


SOURCE_PATH = re.compile(r"`((?:[a-z0-9_.-]+/)+(?:[\w-]+\.(?:py|c|h|mjs|js|html|md|toml|csv|json|yml))?)`")


@each(DOCUMENTS)
def test_paths_in_code_style_exist(document: Path) -> None:
    paths = [path for path in SOURCE_PATH.findall(text_of(document)) if not path.startswith("out/")]
    folders = (TOP, TOP / "taichi_cloth", DOCS)
    wrong = [path for path in paths if not any((folder / path).exists() for folder in folders)]
    assert [path for path in wrong if not path.endswith("/NAME.py")] == []


def test_paths_are_found() -> None:
    text = "`solvers/rk4.py` `docs/` `a.py` `out/shot.png` `simulation/builder.features_of` `tests/web`"
    assert SOURCE_PATH.findall(text) == ["solvers/rk4.py", "docs/"]


def test_links_are_found() -> None:
    assert "screenshots/hero.webp" in LINK.findall((TOP / "README.md").read_text(encoding="utf-8"))
    assert LINK.findall("[a](b.md) ![c](d/e.png#f)") == ["b.md", "d/e.png"]


def slug(heading: str) -> str:
    """Return the anchor of a heading, as repository browsers and the site make it."""
    words = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return "".join(c for c in words if c in "-_ " or c not in string.punctuation + "·×→").replace(" ", "-")


@each(DOCUMENTS)
def test_linked_headings_exist(document: Path) -> None:
    wrong = []
    for link, anchor in ANCHOR.findall(text_of(document)):
        target = document.parent / link if link else document
        if "://" not in link and anchor not in map(slug, HEADING.findall(text_of(target))):
            wrong.append(f"{link}#{anchor}")
    assert wrong == []


def test_anchors_are_lower_case_without_punctuation() -> None:
    assert slug("What fails, and why") == "what-fails-and-why"
    assert slug("[[spheres]]") == "spheres"
    assert slug("`explicit` and [lines](lines.md)") == "explicit-and-lines"


# -- generated blocks --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """Return docs/generate.py as a module."""
    spec = spec_from_file_location("generate", DOCS / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@each([path for path in DOCUMENTS if "<!-- generated:" in text_of(path)])
def test_generated_blocks_are_up_to_date(document: Path, generate: ModuleType) -> None:
    assert generate.brought_up_to_date(text_of(document)) == text_of(document), "run: python docs/generate.py"


def test_all_shipped_meshes_are_described(generate: ModuleType) -> None:
    assert {path.stem for path in (TOP / "assets" / "meshes").glob("*.obj")} == set(generate.program.MESHES)


def test_an_outdated_block_is_replaced(generate: ModuleType) -> None:
    old = "a\n<!-- generated: presets -->\nnothing\n<!-- end -->\nb"
    new = generate.brought_up_to_date(old)
    assert "| silk |" in new.replace("[`silk`](#silk)", "silk")
    assert new.startswith("a\n<!-- generated: presets -->\n\n| ")
    assert new.endswith("\n\n<!-- end -->\nb")


def blocks_of(document: Path) -> dict[str, str]:
    """Return the content of each generated block of a document, by its name."""
    found = re.findall(r"<!-- generated: ([a-z_ ]+?) -->\n(.*?)<!-- end -->", text_of(document), re.DOTALL)
    return dict(found)


BLOCKS = {
    "README.md": {"solvers", "validation_page", "stability_page"},
    "docs/index.md": {"unfinished"},
    "docs/parameters.md": {"unfinished", "parameters"},
    "docs/performance.md": {"unfinished", "goals", "frames", "sheets", "gpu"},
    "docs/accuracy.md": {"unfinished", "validation_summary", "elbow"},
    "docs/limits.md": {"unfinished", "bar_friction", "stability_summary", "nobody", "soak"},
    "docs/choosing.md": {"choosing", "unconverged"},
    "docs/scene_errors.md": {"unfinished", "scene_summary"},
    "docs/scenes.md": {"unfinished", "feature_costs"},
}


@pytest.mark.parametrize("page", BLOCKS)
def test_pages_have_their_generated_blocks(page: str) -> None:
    assert set(blocks_of(TOP / page)) == BLOCKS[page]


@pytest.mark.parametrize(
    ("page", "name"),
    [("README.md", "solvers"), ("docs/performance.md", "goals"), ("docs/performance.md", "frames")],
)
def test_a_figure_edited_by_hand_is_replaced(page: str, name: str, generate: ModuleType) -> None:
    block = blocks_of(TOP / page)[name]
    last = block.rindex(re.findall(r"\d", block)[-1])
    edited = text_of(TOP / page).replace(block, f"{block[:last]}{(int(block[last]) + 1) % 10}{block[last + 1 :]}")
    assert edited != text_of(TOP / page)
    assert generate.brought_up_to_date(edited) == text_of(TOP / page)


def test_the_readme_is_short_and_its_numbers_of_springs_are_correct() -> None:
    text = text_of(TOP / "README.md")
    assert len(text.splitlines()) <= 150
    scene = tc.load_scene("curtain")
    with tc.Simulation(scene) as simulation:
        counts = simulation.topology.family_counts
        rows, columns = simulation.topology.shape
    springs = f"{counts['structural']:,} structural, {counts['shear']:,} shear and {counts['bend']:,} bend springs"
    words = " ".join(text.split())
    assert f"{columns} × {rows} particles on a pole" in words
    assert springs in words
    assert f"{scene.solver.substeps} substeps per frame and {scene.solver.iterations} iterations per substep" in words


# -- figures -----------------------------------------------------------------------------------------------------------

FIGURE = re.compile(
    r"\b\d[\d.]*e[-−]?\d+\b|(?<![\w.×])[−-]?\d[\d.,]*[\s\N{NO-BREAK SPACE}]?"
    r"(?:ms|µs|ns|%|[kMG]B|[KMG]iB|times|per cent|pictures a second|×)(?!\w|[\s\N{NO-BREAK SPACE}]?\d)"
)
# Pages that a command writes completely, and the page of single measurements.
WRITTEN = {
    "validation.md",
    "validation_rows.md",
    "stability.md",
    "stability_rows.md",
    "scene_errors_rows.md",
    "scenes_rows.md",
    "trials.md",
}
# Figures that are not results: arguments, limits and numbers of formulas.
INPUTS = {
    "docs/performance.md": ["2 times"],  # √2 of a proof
    "docs/web.md": ["30 times", "2 kB"],  # limits of the server, in web/
    "docs/parameters.md": ["10 %"],  # end of the scale of the strain view
    "docs/gallery.md": ["10 %"],  # [strain_limit] of the scene `net`
    "docs/choosing.md": ["0.5 %", "16.7 ms"],  # --target-error 0.5; 1/60 s
    "docs/frame_error.md": ["16 times"],  # MANY_ITERATIONS, in simulation/copies.py
    "docs/controls.md": ["2 %"],  # default grab radius
    "docs/solvers/lines.md": ["18, times"],  # equation 18
}


def figures(text: str) -> list[str]:
    """Return the figures with a unit of measured results, outside generated blocks and code blocks."""
    text = re.sub(r"<!-- generated:.*?<!-- end -->", "", text, flags=re.DOTALL)
    return FIGURE.findall(re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE))


@each([path for path in DOCUMENTS if path.name not in WRITTEN])
def test_no_result_is_written_by_hand(document: Path) -> None:
    assert figures(text_of(document)) == INPUTS.get(name_of(document), []), "generate it, or move it to docs/trials.md"


def test_figures_are_found() -> None:
    text = "it takes 0.53 ms at 5×12, 3.4 times C, 2 % more, to 4e-5\n"
    assert figures(text) == ["0.53 ms", "3.4 times", "2 %", "4e-5"]
    memory = "0.2 MiB, 12 MB, 5 kB, 1.5\N{NO-BREAK SPACE}GiB and 3KiB"
    assert figures(memory) == ["0.2 MiB", "12 MB", "5 kB", "1.5\N{NO-BREAK SPACE}GiB", "3KiB"]
    assert figures("<!-- generated: goals -->\n9 ms\n<!-- end -->\n```sh\n7 ms\n```\nin 5 s") == []


def test_the_page_of_trials_says_that_they_are_single_measurements() -> None:
    head = text_of(DOCS / "trials.md")[:600]
    assert "measured once by hand" in head
    assert "the figures here are those of one run" in " ".join(head.split())


@pytest.mark.parametrize("name", SOLVER_NAMES)
def test_every_solver_has_a_page(name: str) -> None:
    page = text_of(DOCS / "solvers" / f"{name}.md")
    assert page.startswith(f"# {name}\n")
    assert f"<!-- generated: solver {name} -->" in page


def test_the_api_page_describes_all_public_names() -> None:
    page = text_of(DOCS / "api.md")
    public = [name for name in tc.__all__ if not name.startswith("_")]
    assert [name for name in public if f"### tc.{name}\n" not in page] == []


# Types in signatures that Python and NumPy have.
COMMON_TYPES = {
    "SupportsIndex",
    "None",
    "False",
    "Path",
    "BinaryIO",
    "PathLike",
    "Callable",
    "Sequence",
    "NDArray",
    "ArrayLike",
    "Simulation",
}


def documented_members(generate: ModuleType) -> dict[str, Any]:
    """Return every function, class and member that the API reference documents, but the internals, by its name."""
    names = {name: getattr(tc, name) for name in tc.__all__ if not name.startswith("_")}
    subjects = [of for subject, of in generate.program.SIMULATION_MEMBERS.items() if subject != "Internals"]
    names |= {f"Simulation.{name}": getattr(tc.Simulation, name) for of in subjects for name in of}
    names["Simulation.__init__"] = tc.Simulation.__init__
    for cls in (tc.GrabHandle, tc.Recorder):
        names |= {f"{cls.__name__}.{key}": value for key, value in vars(cls).items() if not key.startswith("_")}
    return names


def signature_text(member: Any) -> str:
    function = member.fget if isinstance(member, property) else member
    return str(inspect.signature(function)) if inspect.isroutine(function) else ""


def test_names_in_docstrings_of_the_api_can_be_reached(generate: ModuleType) -> None:
    """A name in backticks is public, a parameter or a scene key; so is a type in a signature."""
    members = documented_members(generate)
    keys = {name for row in key_table() for name in (row[1], f"{row[0].strip('[]')}.{row[1]}")}
    known = {
        *keys,
        *sections(),
        *SOLVER_NAMES,
        *generate.program.SIMULATION_ATTRIBUTES,
        *vars(tc.SceneError("", "", "")),
    }
    known |= {"section_key", "ti.init", "with"}
    wrong = []
    for name, member in members.items():
        text = signature_text(member)
        parameters = set(re.findall(r"(\w+):", text))
        for word in re.findall(r"`([A-Za-z_][\w.]*)`", inspect.getdoc(member) or ""):
            word = word.removeprefix("tc.")
            owners = (tc, tc.Simulation, member)
            if word not in known | parameters and word not in members and not any(hasattr(o, word) for o in owners):
                wrong.append(f"{name}: {word}")
        types = set(re.findall(r"\b[A-Z][A-Za-z]+", re.sub(r"'[^']*' = |= '[^']*'", "", text)))
        wrong += [f"{name}: {word}" for word in sorted(types - COMMON_TYPES) if not hasattr(tc, word)]
    assert wrong == []


@pytest.mark.parametrize("name", tc.__all__)
def test_every_public_name_is_listed_and_can_be_imported(name: str) -> None:
    assert name in dir(tc)
    assert getattr(tc, name) is not None


def test_completion_offers_the_documented_members_of_a_simulation(generate: ModuleType) -> None:
    documented = {name for names in generate.program.SIMULATION_MEMBERS.values() for name in names}
    with tc.Simulation({"cloth": {"rows": 3, "columns": 3}}) as simulation:
        offered = {name for name in dir(simulation) if not name.startswith("__")}
    assert offered == documented | set(generate.program.SIMULATION_ATTRIBUTES) | {"frame_error"}


def test_every_strip_of_parameters_has_a_small_image(generate: ModuleType) -> None:
    shown = re.findall(r"\]\((pictures/parameters/.+?\.png)\)", text_of(DOCS / "parameters.md"))
    drawn = [path.relative_to(DOCS).as_posix() for path in (DOCS / "pictures" / "parameters").glob("*.png")]
    assert sorted(shown) == sorted(drawn)
    assert [path for path in shown if (DOCS / path).stat().st_size > 150_000] == []


def test_the_gallery_shows_every_scene() -> None:
    rows = re.findall(r"^\| \[!.*\| `([\w-]+)` \| (.+) \|$", text_of(DOCS / "gallery.md"), re.MULTILINE)
    assert rows == [(name, tc.load_scene(name).title) for name in tc.list_scenes()], "run: make screenshots"


# -- commands that store results ---------------------------------------------------------------------------------------

# For each target of make, the commands it runs.
STORING_TARGETS = {
    "stress": ["stress"],
    "validate": ["ablate", "validate"],
    "errors": ["bench", "bench"],
    "results": ["bench", "bench"],
}


def fake_programs(folder: Path, status: int) -> None:
    """Write programs `taichi-cloth` and `python` that only log their arguments. The former exits with `status`."""
    for name, exit_status in (("taichi-cloth", status), ("python", 0)):
        file = folder / name
        file.write_text(f'#!/bin/sh\necho "{name} $*" >> "{folder}/log"\nexit {exit_status}\n', encoding="utf-8")
        file.chmod(0o755)


@pytest.mark.skipif(shutil.which("make") is None or sys.platform == "win32", reason="needs make and a shell")
@pytest.mark.parametrize("status", [0, 3])
@pytest.mark.parametrize("target", STORING_TARGETS)
def test_documents_are_updated_whatever_the_exit_status(target: str, status: int, tmp_path: Path) -> None:
    fake_programs(tmp_path, status)
    variables = [f"BIN={tmp_path}", f"RESULTS={tmp_path}", "PYTHON=python"]
    command = ["make", "-o", ".venv/ready", "-o", ".venv/tools", *variables, target]
    done = subprocess.run(command, cwd=TOP, capture_output=True, text=True, encoding="utf-8")
    log = [line.split()[:2] for line in (tmp_path / "log").read_text(encoding="utf-8").splitlines()]
    ran = STORING_TARGETS[target] if status == 0 else STORING_TARGETS[target][:1]
    assert log == [*(["taichi-cloth", name] for name in ran), ["python", "docs/generate.py"]], done.stderr
    assert (done.returncode == 0) == (status == 0)
    assert (f"Error {status}" in done.stderr) == (status != 0)


# -- commands and scenes -----------------------------------------------------------------------------------------------


def commands(document: Path) -> list[str]:
    lines = "".join(blocks(document, "sh")).splitlines()
    return [line.partition("#")[0] for line in lines if re.match(r"\s*taichi-cloth\b", line)]


@each([path for path in DOCUMENTS if commands(path)])
def test_commands_are_valid(document: Path) -> None:
    known = {*tc.list_scenes(), "robust"}
    for command in commands(document):
        words = shlex.split(command)[1:] or ["run"]
        words = words if not words[0].startswith("-") else ["run", *words]
        arguments = vars(build_parser(MODULES).parse_args(words))  # exits if a word is not understood
        named = [arguments.get("scene"), arguments.get("file"), *(arguments.get("scenes") or [])]
        names = [str(name) for scene in named for name in (scene if isinstance(scene, list) else [scene]) if name]
        assert [name for name in names if name not in known and not name.endswith(".toml")] == [], command
        assert arguments.get("solver") in (None, "robust", *SOLVER_NAMES), command
        scene = next((name for name in names if name in tc.list_scenes()), "curtain")
        tc.load_scene(scene, **overrides(arguments.get("set") or [], "--set"))


def write_files(folder: Path) -> None:
    """Write the files that the scenes name: a flag of 5×5 vertices in centimeters with two groups, and its maps."""
    points = [f"v {25 * c} {25 * r} 0\nvt {c / 4} {r / 4}" for r in range(5) for c in range(5)]
    corners = [[5 * r + c + k for k in (1, 2, 7, 6)] for c in range(4) for r in range(4)]
    faces = ["f " + " ".join(f"{n}/{n}" for n in face) for face in corners]
    (folder / "flag.obj").write_text("\n".join([*points, "g hoist", *faces[:4], "g fly", *faces[4:]]))
    for name in ("pins", "stiffness", "reach"):
        write_png(folder / f"{name}.png", np.full((4, 4, 3), 200, np.uint8))


@each([path for path in DOCUMENTS if blocks(path, "toml")])
def test_scenes_load_block_by_block_and_all_together(document: Path, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    write_files(tmp_path)
    for block in (*blocks(document, "toml"), "\n".join(blocks(document, "toml"))):
        file.write_text(block, encoding="utf-8")
        tc.load_scene(file)


@pytest.mark.usefixtures("serial_layout")
@each([path for path in DOCUMENTS if blocks(path, "python")])
def test_python_runs(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks(document, "python")), name_of(document), "exec"), {})


@each(DOCUMENTS)
def test_names_of_solvers_fabrics_and_scenes_exist(document: Path) -> None:
    """`solver = "lines"`, `preset="denim"`, `load_scene("curtain")`, --solver lines, fabric=silk."""
    text = text_of(document)
    solvers = re.findall(r"""(?:\bsolver ?= ?"|--solver |\[solver\] name = "|switch_solver\(")(\w+)""", text)
    fabrics = re.findall(r"""(?:\bpreset ?= ?"|\bfabric ?= ?"?)([a-z]+)""", text)
    scenes = re.findall(r"""load_scene\("([^"]+)"|taichi-cloth (?:run|render) ([\w-]+)""", text)
    assert {name for name in solvers if not name.isupper()} <= {*SOLVER_NAMES, "robust"}
    assert set(fabrics) <= set(PRESET_NAMES)
    named = {first or second for first, second in scenes}
    assert {name for name in named if not name.isupper()} <= {*tc.list_scenes(), "my_scene", "sheet"}


# -- site --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built site."""
    pytest.importorskip("material", reason="needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=TOP, capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_loads_nothing_from_the_network(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        fetched = re.findall(
            r"<(?:script|img|iframe|link)\b[^>]* (?:src|href)=\"?https?:[^>]+", page.read_text("utf-8")
        )
        assert fetched == [], page.name
    assert (site / "files" / "screenshots" / "hero.webp").stat().st_size > 100_000
    assert not list(site.rglob("*.pyc"))


@pytest.mark.parametrize(("page", "word"), [("index.html", "wind"), ("solvers/xpbd.html", "simulation")])
def test_the_search_works_in_a_site_that_is_opened_from_a_folder(
    site: Path, page: str, word: str, tmp_path: Path
) -> None:
    pipe = chromium(tmp_path)
    try:
        browser = Browser(pipe, (1280, 800))
        browser.open(site / page, ready="document.readyState === 'complete'")
        x, y = browser.value(
            "(({x, y}) => [x + 9, y + 9])(document.querySelector('.md-search__input').getClientRects()[0])"
        )
        browser.drag((x, y), (x, y))
        browser.call("Input.insertText", text=word)
        browser.key("End", "End")
        found = "document.querySelector('.md-search-result__meta').textContent"
        browser.until(f"/\\d+ matching/.test({found})")
        assert [request for request in browser.requests if request.startswith("http")] == browser.errors == []
    finally:
        pipe.close()


def lines_of(path: Path, names: list[str]) -> int:
    """Return the lines of a module, or of some of its functions and classes."""
    text = path.read_text(encoding="utf-8")
    if not names:
        return len(text.splitlines())
    found = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return sum((found[name].end_lineno or 0) - found[name].lineno + 1 for name in names)


def test_a_change_of_xpbd_needs_less_than_900_lines() -> None:
    rows = re.findall(r"^\| `(\w+/\w+\.py)` \| (.+) \|$", text_of(TOP / "CONTRIBUTING.md"), re.MULTILINE)
    read = {
        name: [] if what.startswith("all") else re.findall(r"`(\w+)`", what.partition(":")[0]) for name, what in rows
    }
    read["solvers/base.py"] = ["Features", "run_frame"]  # and attributes of `Solver`, some 30 lines
    assert len(read) == 8
    assert sum(lines_of(TOP / "taichi_cloth" / name, names) for name, names in read.items()) < 870
