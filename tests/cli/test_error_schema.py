"""The error that a command prints with --json fits its schema."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from imucal.cli import main

_HEAD = "t,gx,gy,gz,ax,ay,az\n"


def _schema() -> dict[str, Any]:
    path = files("imucal.report") / "schema" / "error-2.schema.json"
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document


def _write_logs(folder: Path) -> None:
    rows = "".join(f"{i / 100},{i % 7},{i % 5},{i % 3},0,0,{i % 2}\n" for i in range(300))
    (folder / "no_units.csv").write_text(_HEAD + rows, encoding="utf-8")
    (folder / "no_time.csv").write_text("a,b,c\n" + "1,2,3\n" * 300, encoding="utf-8")
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "limits.toml").write_text("[gyroscop]\nN = 1\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [
        (("fit", "nothing.mcap"), "ReadError"),
        (("fit", "no_units.csv"), "ChoiceError"),
        (("fit", "no_time.csv"), "ChoiceError"),
        (("fit", "no_units.csv", "--levl", "0.9"), "NoSuchOption"),
        (("info", "empty.mcap"), "ReadError"),
        (("adev", "no_units.csv"), "ChoiceError"),
        (("calibrate", "nothing.mcap"), "ReadError"),
        (("check", "nothing-imucal", "--limits", "limits.toml"), "LimitsError"),
        (("compare", "a-imucal", "b-imucal"), "ReadError"),
        (("drift", "nothing-imucal"), "ReadError"),
    ],
)
def test_errors_of_commands_fit_the_schema(
    arguments: tuple[str, ...],
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Errors of reading, of choices with several problems, of limits and of the command line."""
    _write_logs(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--json"])
    document = json.loads(capsys.readouterr().out)
    jsonschema.validate(document, _schema())
    assert document["error"]["type"] == kind
    assert document["error"]["exit_code"] == ended.value.code


def test_the_schema_refuses_an_incomplete_error() -> None:
    """An error with a problem has all of its fields."""
    jsonschema.Draft202012Validator.check_schema(_schema())
    error = {"type": "ReadError", "message": "no", "exit_code": 3}
    fields = {"problem": "no", "place": "", "code": "", "fixes": [], "also": []}
    whole = {"schema": "imucal/error/2", "error": {**error, **fields}}
    jsonschema.validate(whole, _schema())
    for wrong in (
        {**error, "problem": "no"},
        {**error, **fields, "fixes": [{"text": "x"}]},
        {**error, **fields, "also": [{"problem": "no"}]},
        {**error, "exit_code": 0},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**whole, "error": wrong}, _schema())
