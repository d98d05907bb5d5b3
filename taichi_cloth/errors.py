"""Errors that a user can do something about; the command line prints each as one line."""


class OutputInUse(ValueError):
    """The output folder holds something that this run must not, or cannot, go on with. Exit code 2."""


class WrongUse(ValueError):
    """A choice that this program, this scene or this machine does not offer. Exit code 2."""


class BlewUp(RuntimeError):
    """The cloth runs away, or has a position that is no finite number. Exit code 1."""


def why(error: BaseException) -> str:
    """`out/a.png: No space left on device` for an error of the system, without its number; any other as it is."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"


def one_line(text: str) -> str:
    """Line ends and control characters written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
