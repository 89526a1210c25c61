"""Dataclasses to JSON and back by their type hints."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ReadError
from imucal.recording import Sensor
from imucal.report.typed_json import Key, Place, from_json, to_json

_PLACE = Place("a.json", "write it again")


@dataclass(frozen=True, kw_only=True)
class Inner:
    """Texts and pairs."""

    name: str
    pair: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Outer:
    """A field of each kind."""

    kind: Literal["a", "b"]
    sensor: Sensor
    symbol: Annotated[str, Key(choices=("N", "K"))]
    ready: bool
    count: Annotated[int, Key(least=0)]
    value: float
    high: Annotated[float, Key(null=math.inf)]
    share: Annotated[float, Key(null=None, above=0, below=1)]
    limit: float | None
    x: FloatArray
    y: Annotated[FloatArray, Key(like="x")]
    used: IntArray
    matrix: Annotated[FloatArray, Key(shape=(2, 2))]
    inner: Inner
    inners: tuple[Inner, ...]
    by_name: Mapping[str, Inner]
    settings: Mapping[str, object]


def _outer() -> Outer:
    return Outer(
        kind="a",
        sensor=Sensor.GYROSCOPE,
        symbol="K",
        ready=True,
        count=3,
        value=math.nan,
        high=math.inf,
        share=0.5,
        limit=None,
        x=np.array([1.0, np.nan]),
        y=np.array([2.0, 3.0]),
        used=np.array([0, 1]),
        matrix=np.eye(2),
        inner=Inner(name="°", pair=(1.0, 2.5)),
        inners=(Inner(name="b"),),
        by_name={"c": Inner(name="c")},
        settings={"path": None, "deep": {"list": [1, "x"]}},
    )


def test_every_kind_of_value_is_read_back() -> None:
    """Numbers that are not finite are null, and null is NaN or the number of the key."""
    outer = _outer()
    document = json.loads(json.dumps(to_json(outer), allow_nan=False))
    assert (document["value"], document["high"], document["x"]) == (None, None, [1.0, None])
    again = from_json(Outer, document, _PLACE)
    assert to_json(again) == document
    assert math.isnan(again.value)
    assert again.high == math.inf
    assert (again.inner, again.inners, again.by_name) == (outer.inner, outer.inners, outer.by_name)
    assert again.sensor is Sensor.GYROSCOPE
    npt.assert_array_equal(again.x, outer.x)
    npt.assert_array_equal(again.matrix, outer.matrix)
    assert again.used.dtype == np.int64


@pytest.mark.parametrize(
    ("key", "value", "place", "message"),
    [
        ("kind", "c", "kind", 'found "c", expected "a" or "b"'),
        ("sensor", 3, "sensor", 'found 3, expected "gyroscope" or "accelerometer"'),
        ("symbol", "B", "symbol", 'found "B", expected "N" or "K"'),
        ("ready", 1, "ready", "found 1, expected true or false"),
        ("count", -1, "count", "found -1, expected a whole number from 0"),
        ("count", 1.0, "count", "found 1.0, expected a whole number from 0"),
        ("count", 2**63, "count", f"found {2**63}, expected a whole number of 64 bits"),
        ("value", False, "value", "found false, expected a number"),
        ("value", -(10**400), "value", f"found -1{'0' * 38}…, expected a finite number"),
        ("share", None, "share", "found null, expected a number between 0 and 1"),
        ("share", 1, "share", "found 1, expected a number between 0 and 1"),
        ("limit", "1", "limit", 'found "1", expected a number'),
        ("x", [1.0, True], "x[1]", "found true, expected a number"),
        ("y", [1.0], "y", "found a list of 1, expected 2 items, like the other lists"),
        ("used", [0, None], "used[1]", "found null, expected a whole number"),
        ("matrix", [[1.0, 2.0], [3.0]], "matrix[1]", "found [3.0], expected a list of 2"),
        ("matrix", [[1.0, 2.0]], "matrix", "found [[1.0, 2.0]], expected a list of 2"),
        ("inner", [], "inner", "found [], expected an object"),
        ("inner", {}, "inner", "found no keys, expected the key 'name'"),
        ("inners", [{"name": "a"}, {"name": 3}], "inners[1].name", "found 3, expected a text"),
        ("inners", {}, "inners", "found {}, expected a list"),
        ("by_name", {"d": {"name": "d", "pair": [1]}}, "by_name.d.pair", "found [1], expected a list of 2"),
        ("settings", 3, "settings", "found 3, expected an object"),
    ],
)
def test_a_wrong_value_is_refused_at_its_place(key: str, value: object, place: str, message: str) -> None:
    with pytest.raises(ReadError) as caught:
        from_json(Outer, {**to_json(_outer()), key: value}, _PLACE)
    assert caught.value.place == f"a.json: {place}"
    assert caught.value.problem == message
    assert str(caught.value) == f"a.json: {place}: {message}; write it again"


def test_a_key_with_a_default_may_be_missing() -> None:
    """Files of a newer version of the same schema have further keys, which are ignored."""
    assert from_json(Inner, {"name": "a", "more": 1}, _PLACE) == Inner(name="a")
    with pytest.raises(ReadError, match="found pair, expected the key 'name'"):
        from_json(Inner, {"pair": None}, _PLACE)
