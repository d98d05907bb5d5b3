"""What the user reads of an error."""

import errno

from taichi_cloth.errors import why


def test_an_error_of_the_system_is_told_by_its_file_and_reason() -> None:
    assert why(OSError(errno.ENOSPC, "No space left on device", "out/a.png")) == "out/a.png: No space left on device"
    assert why(OSError(errno.EAGAIN, "no more processes")) == "no more processes"
    assert why(OSError("odd")) == "odd"
    assert why(RuntimeError("the cloth blew up")) == "the cloth blew up"
