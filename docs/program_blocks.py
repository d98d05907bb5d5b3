"""Blocks of the documents about the program: keys, fabrics, parameters, bindings and the Python API."""

from __future__ import annotations

import inspect
import re
import runpy
import textwrap
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tables import table

import taichi_cloth as tc
from taichi_cloth.geometry.mesh_reader import parse_obj
from taichi_cloth.geometry.topology import Topology
from taichi_cloth.kernels.step_params import MAX_GRABS
from taichi_cloth.scene import key_table, schema
from taichi_cloth.scene.fabric_schema import PRESET_NAMES
from taichi_cloth.scene.keys import KEYS_TITLE, keys_of
from taichi_cloth.scene.presets import MIN_EIGENVALUE, Preset, load_preset, membrane_constants_of
from taichi_cloth.viewer import input as controls

DOCS = Path(__file__).parent


def keys() -> str:
    blocks = []
    docs = {"": "These keys come before all sections."}
    sliders: dict[tuple[str, str], str] = {}
    for part in schema.sections().values():
        name = f"[[{part.name}]]" if part.is_array else f"[{part.name}]"
        docs[name] = described(part.cls)
        sliders |= {
            (name, key): "{:g} to {:g}".format(*about.slider)
            for key, about in keys_of(part.cls).items()
            if about.slider
        }
    for section in dict.fromkeys(row[0] for row in key_table()):
        title = f"## {section}" if section else "## Top level"
        rows = [
            [f"`{key}`", f"`{default}`", unit, bounds.removesuffix(f" {unit}"), sliders.get((at, key), ""), text]
            for at, key, default, unit, bounds, text in key_table()
            if at == section
        ]
        blocks.append(
            f"{title}\n\n{docs[section]}\n\n" + table(["key", "default", "unit", "range", "slider", "meaning"], rows)
        )
    return "\n\n".join(blocks)


UNITS = {"area_density": "kg/m²", "warp": "N/m", "weft": "N/m", "bias": "N/m", "bending": "N·m", "damping": "s"}


def presets() -> str:
    header = ["preset", "fabric", *(f"{name.replace('_', ' ')} [{unit}]" for name, unit in UNITS.items())]
    fabrics = [load_preset(name) for name in PRESET_NAMES]
    rows = [[f"[`{f.name}`](#{f.name})", f.title, *(shown_value(f, name) for name in UNITS)] for f in fabrics]
    return table(header, rows)


def shown_value(fabric: Preset, name: str) -> str:
    """Return a property of a fabric for a table, with both numbers of one that differs along warp and weft."""
    if name == "bending" and fabric.bending_weft:
        return f"{fabric.bending:.3g}, weft {fabric.bending_weft:.3g}"
    value = getattr(fabric, name)
    return f"{value:.5g}" if value else "not measured"


def sources() -> str:
    return "\n\n".join(f"### {one.name}\n\n{sources_of(one)}" for one in map(load_preset, PRESET_NAMES))


def sources_of(fabric: Preset) -> str:
    """Return the title of a fabric and a table of its numbers with their sources."""
    rows = []
    if "tensor" in fabric.sources:
        strips = fabric.warp, fabric.weft, fabric.bias
        tensor = membrane_constants_of(*strips, fabric.poisson)
        rows.append(["C₁₁, C₂₂, C₁₂, C₆₆", listed(fabric.measured_tensor or tensor, "N/m"), fabric.sources["tensor"]])
        if fabric.measured_tensor is not None:
            least = f"with eigenvalues of at least {MIN_EIGENVALUE:g} of the largest"
            rows.append(["projected", listed(tensor, "N/m"), f"computed: the nearest tensor {least}."])
        rows.append(["warp, weft, bias", listed(strips, "N/m"), "computed from the tensor: strips of a membrane."])
    for name, unit in UNITS.items():
        if name in fabric.sources:
            rows.append([name.replace("_", " "), f"{getattr(fabric, name):.5g} {unit}", fabric.sources[name]])
    if "bending_weft" in fabric.sources:
        rows.append(["bending, weft", f"{fabric.bending_weft:.4g} N·m", fabric.sources["bending_weft"]])
    if "poisson" in fabric.sources:
        rows.append(["Poisson's ratio", f"{fabric.poisson:g}", fabric.sources["poisson"]])
    shares = f"structural {fabric.structural:g}, shear {fabric.shear:g}, bend {fabric.bend:g}"
    rows.append(["stiffness for `verlet`", shares, fabric.sources["verlet"]])
    return f"{fabric.title}.\n\n" + table(["property", "value", "source"], rows)


def listed(values: Iterable[float], unit: str) -> str:
    """Return numbers separated by commas, with their unit."""
    return f"{', '.join(f'{value:.4g}' for value in values)} {unit}"


# What the meshes of assets/meshes are.
MESHES = {
    "round": "a round sheet",
    "knot": "a ribbon with a loose knot",
    "walker_clothes": "a skirt and a cape for `walker`",
    "skirt": "a circle skirt, cut flat",
    "disc": "a round plate, such as a table top",
    "bust": "a head on its shoulders",
    "walker": "a figure; its walk is the clip `walker.pc2`",
}


def meshes() -> str:
    """Return the shipped meshes with their sizes."""
    rows = []
    for name, what in MESHES.items():
        obj = parse_obj(DOCS.parent / "assets" / "meshes" / f"{name}.obj")
        sides = Counter(frozenset(side) for face in obj.faces for side in pairwise((*face, face[0])))
        size = " × ".join(f"{length:g}" for length in np.ptp(obj.vertices, axis=0).round(2))
        triangles = sum(len(face) - 2 for face in obj.faces)
        use = "`[cloth]`" if 1 in sides.values() else "`[[meshes]]`, `[cloth]`"
        rows.append([f"`{name}`", what, size, f"{len(obj.vertices):,}", f"{triangles:,}", use])
    return table(["file", "what", "size [m]", "vertices", "triangles", "for"], rows)


def parameters() -> str:
    strips = runpy.run_path(str(DOCS.parent / "screenshots" / "parameters.py"))["STRIPS"]
    blocks = []
    for strip in strips:
        says = strip.says[0].upper() + strip.says[1:]
        values = " · ".join(strip.panels)
        title = strip.name.replace("_", " ").capitalize()
        picture = f"![{strip.name}: {values}](pictures/parameters/{strip.name}.png)"
        caption = f"Scene `{strip.scene}` after {strip.frame} frames."
        blocks.append(f"## {title}\n\n{says}.\n\n{picture}\n\n**{values}** · {caption}")
    return "\n\n".join(blocks)


# Public members of `Simulation` by subject.
SIMULATION_MEMBERS = {
    "Time": ("step", "step_by_substep", "reset", "seconds", "substeps", "min_stable_substeps", "close", "closed"),
    "State": ("positions", "velocities", "triangles", "set_state", "save", "load", "torn", "untear"),
    "Export": ("export", "export_clip"),
    "Metrics": ("metrics", "frame_error", "intersections", "colliders", "features", "method", "warnings"),
    "Forces and energy": ("forces", "reaction_forces", "elastic_energy"),
    "Grabs, pins and moved colliders": (
        *("grab", "grab_handles", "grabbed", "pin", "unpin", "added_pins", "move_collider"),
    ),
    "Changes": ("switch_solver", "switch_fabric", "switch_scene", "apply", "tuned_scene"),
    "Internals": ("solver", "cloth"),
}

SIMULATION_ATTRIBUTES = {
    "params": "runtime parameters by name, and the switch `wind`: `params[name]` reads one, `params[name] = value` sets"
    " it for the next frame, `params.info(name)` has its range, unit and help",
    "frame": "number of the current frame; 0 at the start and after `reset`",
    "penetration_free_since": "with `self_collision.penetration_free`, the first frame from which no part of the cloth"
    " passes through another; None without it, and while there are intersections",
    "scene": "the running `Scene`",
    "original_scene": "the `Scene` that the simulation was opened with",
    "topology": "the [particles, springs and triangles](#simulationtopology), without those that tore",
    "listeners": "functions that are called with every `Event`, after it was carried out",
}


def bindings() -> str:
    """Return the table of mouse and keys."""
    return "\n".join(controls.table())


def api() -> str:
    """Return every public name with its signature and docstring."""
    functions = (
        "init",
        "list_scenes",
        "list_presets",
        "list_solvers",
        "load_scene",
        "save_scene",
        "render_image",
        "render_video",
        "export_mesh",
        "replay",
    )
    blocks = [entry("###", f"tc.{name}", getattr(tc, name)) for name in functions]
    blocks += [
        f"### tc.Simulation\n\n{described(tc.Simulation)}\n\n{signature('tc.Simulation', tc.Simulation)}",
        described(tc.Simulation.__init__),
        table(["attribute", "meaning"], [[f"`{name}`", what] for name, what in SIMULATION_ATTRIBUTES.items()]),
    ]
    for subject, names in SIMULATION_MEMBERS.items():
        blocks.append(f"**{subject}**")
        blocks += [entry("####", f"simulation.{name}", getattr(tc.Simulation, name)) for name in names]
    blocks.append(f"### tc.GrabHandle\n\nThe result of `simulation.grab`. There are at most {MAX_GRABS} at a time.")
    blocks += members("grab", tc.GrabHandle)
    blocks.append(f"### tc.ClothMetrics\n\nThe result of `simulation.metrics`.\n\n{fields_of(tc.ClothMetrics)}")
    remaining = (
        "N particles, E springs and T triangles. Springs and triangles that tore are missing; particles are all there."
    )
    blocks.append(f"### simulation.topology\n\n{remaining}\n\n{fields_of(Topology)}")
    measured = (
        "What `simulation.frame_error` is after `simulation.step(measure_error=True)` ([explained](frame_error.md))."
    )
    blocks.append(f"### tc.FrameError\n\n{measured}\n\n{fields_of(tc.FrameError)}")
    colliders = "One of the list that `simulation.colliders` returns."
    blocks.append(f"### tc.PosedCollider\n\n{colliders}\n\n{fields_of(tc.PosedCollider)}")
    blocks.append(f"### tc.Event\n\n{described(tc.Event)}\n\n{fields_of(tc.Event)}")
    blocks.append(f"### tc.Recorder\n\n{described(tc.Recorder)}\n\n{signature('tc.Recorder', tc.Recorder)}")
    blocks += [entry("####", f"recorder.{name}", getattr(tc.Recorder, name)) for name in ("save", "restart", "frames")]
    pixels = "`pixels`: red, green and blue, uint8 (height, width, 3), top row first."
    blocks.append(f"### tc.Image\n\n{described(tc.Image)} {pixels}")
    blocks.append(entry("####", "image.save", tc.Image.save))
    blocks.append(f"### tc.Scene\n\n{described(tc.Scene)} Its fields are the sections of a scene file.")
    for section in schema.sections().values():
        title = f"[[{section.name}]]" if section.is_array else f"[{section.name}]"
        link = f"Keys of `{title}`: [{section.name}](keys.md#{section.name})."
        blocks.append(f"### tc.{section.cls.__name__}\n\n{described(section.cls)}\n\n{link}")
    blocks += [f"### tc.{name}\n\n{described(getattr(tc, name))}" for name in ("SceneError", "UsageError", "Diverged")]
    return "\n\n".join(blocks)


def fields_of(cls: type) -> str:
    """Return the table of the fields of a class, which have their meaning in a comment or in the docstring below."""
    line = r'^    (\w+): (.+?)(?: = .+?)?(?:  # (.+)|\n    """(.+?)(?:"""|$))'
    found = re.findall(line, inspect.getsource(cls), re.MULTILINE)
    rows = [[f"`{name}`", f"`{kind}`", comment or text] for name, kind, comment, text in found]
    return table(["name", "type", "meaning"], rows)


def members(name: str, cls: type) -> list[str]:
    """Return the entries of all public members of a class."""
    public = {key: value for key, value in vars(cls).items() if not key.startswith("_")}
    return [entry("####", f"{name}.{key}", one) for key, one in public.items() if not inspect.ismemberdescriptor(one)]


def entry(rank: str, name: str, member: Any) -> str:
    """Return heading, signature or type, and docstring of a member."""
    if isinstance(member, property):
        kind = str(inspect.signature(member.fget).return_annotation).strip("'")
        return f"{rank} {name}\n\n`{kind}`. {described(member)}"
    return f"{rank} {name}\n\n{signature(name, member)}\n\n{described(member)}"


def signature(name: str, member: Any) -> str:
    """Return a signature as a code block, without `self` and without quotes around annotations."""
    found = inspect.signature(member)
    parameters = [p for p in found.parameters.values() if p.name != "self"]
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(found.replace(parameters=parameters)))
    return f"```text\n{name}{text.removesuffix(' -> None')}\n```"


def described(member: Any) -> str:
    text, _, _ = textwrap.dedent(inspect.getdoc(member) or "").partition(f"\n\n{KEYS_TITLE}")
    return text.strip()


BLOCKS = (keys, presets, sources, meshes, parameters, bindings, api)
