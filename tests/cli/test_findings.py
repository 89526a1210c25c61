"""Findings on standard error: grave ones first, each sentence once."""

import click
import pytest

from imucal.cli._printing import print_findings
from imucal.cli.context import remember
from imucal.findings import Finding


def spikes(axis: str, count: int) -> Finding:
    """Return a warning that differs from axis to axis."""
    return Finding(level="warning", code="spikes", axis=axis, text=f"{count} spikes were replaced.")


FINDINGS = (
    Finding(level="info", code="delay", text="Messages came late."),
    spikes("gyro_x", 3),
    spikes("gyro_y", 4),
    spikes("accel_z", 5),
    Finding(level="error", code="motion", text="It moved.", keep_s=(3.0, 70.0)),
    Finding(level="warning", code="gaps", text="12 samples are missing.", advice="Record again."),
    Finding(level="warning", code="tone", axis="gyro_x", text="A tone."),
    Finding(level="warning", code="tone", axis="gyro_z", text="A tone."),
)


def test_one_finding_represents_those_that_differ_in_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    """The line contains their number and axes; standard output is empty."""
    print_findings(FINDINGS)
    out, err = capsys.readouterr()
    assert out == ""
    assert " ".join(err.split()) == (
        "error [motion]: It moved. Try --skip 3s --take 67s. warning [spikes] gyro_x: 3 spikes were "
        "replaced. (2 more of this kind, on gyro_y accel_z; -v shows all) warning [gaps]: 12 samples are "
        "missing. Record again. warning [tone] gyro_x gyro_z: A tone. info [delay]: Messages came late."
    )


def test_verbose_prints_all_and_quiet_none(capsys: pytest.CaptureFixture[str]) -> None:
    """Quiet goes before verbose."""
    with click.Context(click.Command("fit")) as context:
        remember(context, click.Option(["--verbose"]), value=True)
        print_findings(FINDINGS)
        assert capsys.readouterr().err.count("[spikes]") == 3
        remember(context, click.Option(["--quiet"]), value=True)
        print_findings(FINDINGS)
    assert capsys.readouterr().err == ""
