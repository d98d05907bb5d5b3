"""Which cases, variants and settings to run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from ..errors import WrongUse
from ..solvers import SOLVERS
from . import catalogue
from .case import Case
from .setting import SETTINGS, Setting
from .unit import Unit


def chosen(
    only: str | None = None,
    variant: str | None = None,
    setting: str | None = None,
    *,
    long: bool = False,
    tear: float | None = None,
) -> list[Unit]:
    """Every variant of the cases, by number or name, with each setting or with one.

    `long` is the long run of a million frames. `tear` is the strain at which threads give way, with the settings that
    can do it. Raises WrongUse for no case or variant, for a long run of another, and for a setting that cannot tear.
    """
    cases = [case for case in catalogue.CASES if only is None or only in (str(case.number), case.name)]
    if not cases:
        raise WrongUse(f"no case {only!r}: {', '.join(f'{c.number} {c.name}' for c in catalogue.CASES)}")
    if long:
        if [case.number for case in cases] != [catalogue.LONG.number]:
            raise WrongUse(f"--long is about the long run: it goes with --only {catalogue.LONG.number}")
        cases = [catalogue.LONG]
    if variant is not None:
        cases = [of_variant(cases, variant)]
    return [Unit(case, one, with_it) for with_it in settings(setting, tear) for case in cases for one in case.variants]


def of_variant(cases: Iterable[Case], name: str) -> Case:
    """The one case, with this variant alone."""
    case, *others = cases
    if others:
        raise WrongUse("--variant is one of a case's: it goes with --only")
    found = tuple(variant for variant in case.variants if variant.name == name)
    if not found:
        raise WrongUse(f"{case.name} has no variant {name!r}: {', '.join(v.name for v in case.variants)}")
    return replace(case, variants=found)


def settings(name: str | None, tear: float | None) -> list[Setting]:
    found = [one for one in SETTINGS.values() if name in (None, one.name)]
    if tear is None:
        return found
    able = [one for one in SETTINGS.values() if not SOLVERS[one.solver.name].needs_rows]
    tearing = [one.tearing(tear) for one in found if one in able]
    if not tearing:
        others = ", ".join(one.name for one in able)
        raise WrongUse(f"{name} needs a grid of whole rows, and one that tears loses its rows: take {others}")
    return tearing
