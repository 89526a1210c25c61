"""The arrays of an HDF5 file, also of MATLAB 7.3; they must be in the file itself."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.readers.compression import most_unpacked
from imucal.readers.tables.notes import Notes, RefusedError

#: Signature of a superblock.
_MAGIC = b"\x89HDF\r\n\x1a\n"
#: First place of the superblock after the start of the file, in bytes; the others are its doubles.
_FIRST_BLOCK = 512
#: Most datasets and groups; opening one takes 1 ms.
_MAX_NODES = 4000


def arrays(path: Path, notes: Notes) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numeric arrays of a file by name. Runs in the child.

    Raises RefusedError if data are in other files or virtual, or too large for the file.
    """
    import h5py

    with h5py.File(path) as file:
        nodes = dict(_nodes(file))
        matlab = any("MATLAB_class" in node.attrs for name, node in nodes.items() if "/" not in name)
        for name, node in nodes.items():
            kind = node.attrs.get("MATLAB_class", b"").decode("latin-1") if matlab else ""
            if kind in {"char", "cell"}:
                continue
            label = name.replace("/", ".")
            if "MATLAB_object_decode" in node.attrs:
                notes.objects[label] = kind
            elif isinstance(node, h5py.Dataset):
                if node.dtype.kind in "biufV":
                    # MATLAB stores matrices transposed.
                    yield label, np.asarray(node[()].T if matlab else node[()])
                elif node.dtype.kind == "c":
                    notes.skip(label, node.shape, node.dtype)
            yield from _single_numbers(name, {} if matlab else node.attrs).items()


def _nodes(file: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - h5py is imported late
    """Yield the file, its groups and datasets by path; raises RefusedError."""
    import h5py

    yield "", file
    groups = [("", file)]
    seen = {h5py.h5o.get_info(file.id).addr}
    while groups:
        path, group = groups.pop()
        if len(seen) + len(group) > _MAX_NODES:
            found = f"it contains at least {len(seen) + len(group)} groups and datasets"
            raise RefusedError(f"{found}; expected at most {_MAX_NODES}; save only those of the IMU")
        for name in group:
            link, place = group.get(name, getlink=True), f"{path}/{name}".lstrip("/")
            if isinstance(link, h5py.ExternalLink):
                raise RefusedError(_elsewhere(f"{place} is a link to the file {link.filename}"))
            # MATLAB's cells are in these groups.
            if isinstance(link, h5py.SoftLink) or place in {"#refs#", "#subsystem#"}:
                continue
            node = group[name]
            address = h5py.h5o.get_info(node.id).addr
            if address in seen:
                continue
            seen.add(address)
            if isinstance(node, h5py.Dataset):
                _require_own_data(place, node)
            elif isinstance(node, h5py.Group):
                groups.append((place, node))
            yield place, node


def _require_own_data(name: str, node: Any) -> None:  # noqa: ANN401 - h5py's
    if node.external:
        raise RefusedError(_elsewhere(f"{name} has its data in the file {node.external[0][0]}"))
    if node.is_virtual:
        source = next((source.file_name for source in node.virtual_sources()), "another file")
        raise RefusedError(_elsewhere(f"{name} is a virtual dataset with its data in {source}"))
    size, stored = math.prod(node.shape or (0,)) * node.dtype.itemsize, node.id.get_storage_size()
    if size > most_unpacked(stored):
        found = f"{name} declares {size} bytes and stores {stored}"
        raise RefusedError(f"{found}; no recording is compressed so much, save its samples again")


def _elsewhere(found: str) -> str:
    return f"{found}; expected data in the file itself; write all arrays to one file"


def _single_numbers(owner: str, attributes: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    numbers = {f"{owner}/{key}".strip("/").replace("/", "."): np.asarray(v) for key, v in attributes.items()}
    return {name: value for name, value in numbers.items() if value.size == 1 and value.dtype.kind in "iuf"}


def damage_of(path: Path) -> str:
    """Return the damage if a file is longer than the end in its superblock, or an empty text.

    Source: HDF5 File Format Specification 3.0, II.A.
    """
    size, end = path.stat().st_size, 0
    with path.open("rb") as file:
        at = 0
        while at < size and not end:
            file.seek(at)
            end = _end_of_file(file.read(64))
            at = 2 * at or _FIRST_BLOCK
    if end and size != end:
        return f"it has {size} bytes, and its superblock declares {end}"
    return ""


def _end_of_file(block: bytes) -> int:
    """Return the address in a superblock; 0 if there is none or it is unknown."""
    if not block.startswith(_MAGIC) or len(block) < 64:
        return 0
    version = block[8]
    if version > 3:
        return 0
    # Versions 2 and 3 have the size of addresses at byte 9, and the first address at byte 12.
    width, first = (block[13], 24 + 4 * version) if version < 2 else (block[9], 12)
    start = first + 2 * width
    return int.from_bytes(block[start : start + width], "little")
