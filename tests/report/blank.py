"""Blank pictures for tests that ignore pictures: drawing a small log is four times slower than its fit."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from unittest import mock

from imucal.fleet import files
from imucal.report import figure

__all__ = ["blank_pictures"]

#: One white pixel in each format.
_BLANK = {
    "png": bytes.fromhex(
        "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b55"
        "0000000a4944415478da63f80f00010101001cb08c990000000049454e44ae426082"
    ),
    "svg": b'<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>',
    "pdf": b"%PDF-1.4\n%%EOF\n",
}


@contextlib.contextmanager
def blank_pictures() -> Iterator[None]:
    """Write and show pictures of reports and fleets without drawing them."""

    def undrawn(*_: object) -> None:
        return None

    def of_a_fleet(_: Callable[[], object], forms: Sequence[str]) -> dict[str, bytes]:
        return {form: _BLANK[form] for form in forms}

    with (
        mock.patch.multiple(figure, axis_figure=undrawn, sensor_figure=undrawn),
        mock.patch.object(figure, "render", lambda _, form, **__: _BLANK[form]),
        mock.patch.object(files, "drawn_as", of_a_fleet),
    ):
        yield
