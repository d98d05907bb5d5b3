"""Error messages for the user."""

import errno

from taichi_cloth.system.errors import error_text


def test_the_text_of_an_os_error_has_its_file_and_reason() -> None:
    assert (
        error_text(OSError(errno.ENOSPC, "No space left on device", "out/a.png"))
        == "out/a.png: No space left on device"
    )
    assert error_text(OSError(errno.EAGAIN, "no more processes")) == "no more processes"
    assert error_text(OSError("odd")) == "odd"
    assert error_text(RuntimeError("the cloth blew up")) == "the cloth blew up"
