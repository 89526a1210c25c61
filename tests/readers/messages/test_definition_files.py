"""Message definitions in the user's files, as packages contain them, used only for the types they define."""

from pathlib import Path
from typing import Any

import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from imucal.readers.messages.definitions import definition_of, read_definitions
from tests.raising import raises
from tests.readers.logs import Message, header, samples, store, write_mcap
from tests.readers.messages.test_messages import check

TRUTH = samples(120)
KIND = "acme/msg/Board"
BOARD = "Header header\nuint8 state\nPair pair  # of this package\nother_msgs/Note note\n"
PAIR = "geometry_msgs/Vector3 gyro\ngeometry_msgs/Vector3 accel\n"
NOTE = "string<=8 text 'x'\nint8 LEVEL=3\n"
#: This type differs only in its name and in the order of its fields.
OTHER = "acme/msg/Swapped"


def log(folder: Path) -> Path:
    """Write two topics of types that the log does not define."""
    types = store(
        acme__msg__Board=BOARD.replace("Header", "std_msgs/Header"),
        acme__msg__Pair=PAIR,
        other_msgs__msg__Note=NOTE.replace(" 'x'", ""),
        acme__msg__Swapped="std_msgs/Header header\nfloat64[3] accel\nfloat64[3] gyro",
    )
    known = types.types
    messages = []
    for row, when in enumerate(TRUTH.log.tolist()):
        stamp = header(types, int(TRUTH.stamps[row]))
        vector = known["geometry_msgs/msg/Vector3"]
        pair = known["acme/msg/Pair"](vector(*TRUTH.gyro[row].tolist()), vector(*TRUTH.accel[row].tolist()))
        note = known["other_msgs/msg/Note"]("n" * (row % 8))
        board: Any = known[KIND](stamp, 1, pair, note)
        swapped: Any = known[OTHER](stamp, TRUTH.accel[row], TRUTH.gyro[row])
        for topic, kind, message in (("/board", KIND, board), ("/swapped", OTHER, swapped)):
            data = bytes(types.serialize_cdr(message, kind))
            messages.append(Message(topic=topic, type=kind, log=when, data=data))
    return write_mcap(
        folder / "log.mcap", messages, types=types, definitions={KIND: ("", ""), OTHER: ("", "")}
    )


def package(folder: Path) -> Path:
    """Write the definitions as packages contain them; return the parent folder."""
    for name, text in (("acme/msg/Board", BOARD), ("acme/msg/Pair", PAIR), ("other_msgs/msg/Note", NOTE)):
        file = folder / "src" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return folder / "src"


def test_definitions_of_a_folder_of_packages_are_used(tmp_path: Path) -> None:
    """Nested types belong to the package, to another one, or to ROS. The other topic is not affected."""
    path, folder = log(tmp_path), package(tmp_path)
    check(read(path, message_definition=folder))
    notes = {topic.name: topic for topic in describe(path).topics}
    assert notes["/board"].sensors == ()
    with pytest.raises(ChoiceError) as caught:
        read(path, topic="/swapped", message_definition=folder)
    assert str(caught.value) == (
        f"{path}: topic /swapped of type {OTHER} can't be read: the log has no definition of {OTHER}; the "
        "given ones define acme/Board, acme/Pair, other_msgs/Note; give its .msg file, Swapped.msg"
    )


def test_definition_files_can_be_given_one_by_one(tmp_path: Path) -> None:
    """The order of the files is free, and a file outside a package has its own name as type."""
    path, folder = log(tmp_path), package(tmp_path)
    files = sorted(folder.rglob("*.msg"), reverse=True)
    check(read(path, message_definition=files))
    loose = []
    for file in files:
        loose.append(tmp_path / file.name)
        loose[-1].write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    check(read(path, message_definition=loose))


def test_a_missing_nested_type_is_reported(tmp_path: Path) -> None:
    """The nested type is neither given nor part of ROS."""
    path, folder = log(tmp_path), package(tmp_path)
    with raises(ChoiceError, "other_msgs/Note", place="log.mcap", argument="message_definition"):
        read(path, topic="/board", message_definition=folder / "acme")


def test_columns_of_a_given_type_can_be_named(tmp_path: Path) -> None:
    """The columns may be after a list of texts."""
    path, folder = log(tmp_path), package(tmp_path)
    check(read(path, message_definition=folder, columns="g=pair.gyro,a=pair.accel", gyro_unit="rad/s"))


def test_a_path_without_definitions_is_refused(tmp_path: Path) -> None:
    """Cases: a folder without definitions, and an unreadable file."""
    path = log(tmp_path)
    empty = tmp_path / "empty"
    empty.mkdir()
    with raises(ReadError, r"no \.msg files", place="empty"):
        read(path, message_definition=empty)
    with raises(ReadError, "can't be opened", place="none.msg"):
        read(path, message_definition=tmp_path / "none.msg")
    (tmp_path / "Board.msg").write_bytes(b"\xff\xfe\x00")
    with raises(ReadError, "can't be read", place="Board.msg"):
        read(path, message_definition=tmp_path / "Board.msg")


def test_the_folder_above_msg_is_the_package(tmp_path: Path) -> None:
    """Files in other folders have no package."""
    package(tmp_path)
    given = read_definitions([tmp_path / "src" / "acme"])
    assert set(given) == {"acme/Board", "acme/Pair"}
    assert definition_of("acme/msg/Pair", given) == PAIR
    assert definition_of("other/msg/Pair", given) is None
    assert definition_of("other/msg/Pair", {"/Pair": PAIR}) == PAIR


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("acme/msg/Board.msg", "acme/Board"),
        ("msg/acme__Board.msg", "{}/Board"),
        ("Board.msg", "/Board"),
        ("acme.v2.Board.msg", "/Board"),
        ("acme/other/Board.msg", "/Board"),
    ],
)
def test_a_file_names_its_type(file: str, name: str, tmp_path: Path) -> None:
    """Packages and versions can precede the name of the type."""
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("int8 x", encoding="utf-8")
    assert read_definitions([path]) == {name.format(tmp_path.name): "int8 x"}
