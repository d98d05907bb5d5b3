"""Failures whose cause is known: which bound breaks, and by how much at most. All others are unexplained."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .unit import Result


@dataclass(frozen=True)
class Known:
    """Why these variants of a case fail with these settings."""

    case: int
    variants: tuple[str, ...]
    settings: tuple[str, ...]
    what: str  # the bound that breaks, as `Failure.what`
    most: float  # the value that breaks it, at most
    reason: str  # with the test that shows it, or its source

    def explains(self, result: Result) -> bool:
        failure = result.failure
        return (
            failure is not None
            and (result.case, failure.what) == (self.case, self.what)
            and result.variant in self.variants
            and result.setting in self.settings
            and failure.value <= self.most
        )


# Only what an experiment that is a test, or a published result, has shown.
KNOWN: tuple[Known, ...] = ()


def reason_of(result: Result) -> str:
    """Why it failed, empty where that is not known."""
    return next((known.reason for known in KNOWN if known.explains(result)), "")


def unexplained(results: Iterable[Result]) -> list[Result]:
    return [result for result in results if result.failure and not reason_of(result)]


def unused(results: Iterable[Result]) -> list[Known]:
    """Reasons for what did not happen."""
    some = list(results)
    return [known for known in KNOWN if not any(known.explains(result) for result in some)]
