"""Tests of simulated logs in all containers."""

import json
import shlex
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from click.testing import CliRunner

from imucal import simulation
from imucal.cli import imucal
from imucal.errors import WriteError
from imucal.noise import NoiseModel
from imucal.readers import read
from imucal.recording import Recording
from imucal.simulation import WRITERS, SensorTruth, simulate_recording, write_log

GRAVITY = 9.80665


def short_recording(seed: int = 7) -> Recording:
    """Return ten seconds at 100 Hz with a gap."""
    return simulate_recording(
        gyroscope=SensorTruth(model=NoiseModel.parse("N=1e-4 + K=1e-5"), mean=(0.0, 0.0, 0.0)),
        accelerometer=SensorTruth(model=NoiseModel.parse("N=1e-3 + B=1e-4"), mean=(0.0, 0.0, GRAVITY)),
        rate_hz=100.0,
        duration_s=10.0,
        seed=seed,
        gaps_s=[(4.0, 0.5)],
    )


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_every_container_is_read_back_exactly(suffix: str, tmp_path: Path) -> None:
    """Samples, rate and gap are equal."""
    recording = short_recording()
    path = tmp_path / f"log{suffix}"
    write_log(recording, path)
    back = read(path)
    assert [series.name for series in back.series] == [series.name for series in recording.series]
    for written, found in zip(recording.series, back.series, strict=True):
        npt.assert_array_equal(found.samples, written.samples)
        assert found.clock.segments == written.clock.segments
        assert found.rate_hz == pytest.approx(100.0, rel=1e-9)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".csv", ".mcap", ".bag"])
def test_a_log_does_not_depend_on_the_size_of_blocks(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gap is inside a block, and samples are in temporary files."""
    whole, parts = tmp_path / f"whole{suffix}", tmp_path / f"parts{suffix}"
    write_log(short_recording(), whole)
    monkeypatch.setattr(simulation, "_MESSAGES", 64)
    monkeypatch.setenv("IMUCAL_MEMORY", "10k")
    write_log(short_recording(), parts)
    assert parts.read_bytes() == whole.read_bytes()


def test_a_bag_has_frames_that_ros1_reads(tmp_path: Path) -> None:
    """Its decoder wants independent blocks and a checksum, and refuses a frame with its size."""
    path = tmp_path / "log.bag"
    write_log(short_recording(), path)
    _, *frames = path.read_bytes().split(b"\x04\x22\x4d\x18")
    assert {frame[0] for frame in frames} == {0b01100100}


@pytest.mark.slow
def test_a_long_log_is_written_in_blocks(tmp_path: Path) -> None:
    """Its messages have 80 MB, which would exceed the memory of a block several times."""
    script = f"""
        import resource
        from imucal.cli import imucal
        def simulate(name, duration):
            imucal(["simulate", "N=1e-4", "--duration", duration, "-q", "-o", name], standalone_mode=False)
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        short = simulate({str(tmp_path / "a.mcap")!r}, "8min")
        long = simulate({str(tmp_path / "b.mcap")!r}, "21min")
        assert long - short < 50_000, (short, long)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    subprocess.run(command, check=True, timeout=60)  # noqa: S603 - this interpreter, and a text of ours


def test_the_seed_determines_the_samples() -> None:
    first, again, other = short_recording(), short_recording(), short_recording(seed=8)
    npt.assert_array_equal(first.series[0].samples, again.series[0].samples)
    assert not np.array_equal(first.series[0].samples, other.series[0].samples)


def test_samples_are_integer_multiples_of_the_resolution() -> None:
    truth = SensorTruth(model=NoiseModel.parse("N=1e-2"), mean=(0.0, 0.0, GRAVITY), lsb=0.125)
    samples = np.stack(list(truth.rows(100, rate_hz=100.0, rng=np.random.default_rng(1))))
    npt.assert_array_equal(samples / 0.125, np.round(samples / 0.125))


def test_gaps_that_remove_all_samples_are_rejected() -> None:
    truth = SensorTruth(model=NoiseModel.parse("N=1"), mean=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="the gaps remove all samples"):
        simulate_recording(
            gyroscope=truth, accelerometer=truth, rate_hz=10.0, duration_s=1.0, seed=0, gaps_s=[(0.0, 5.0)]
        )


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(WriteError) as caught:
        write_log(short_recording(), path)
    assert str(caught.value) == (f"{path}: exists already; choose another name, or remove it")
    assert path.read_text(encoding="utf-8") == "mine"


def test_the_error_for_an_unknown_suffix_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(WriteError) as caught:
        write_log(short_recording(), tmp_path / "log.xyz")
    assert str(caught.value) == (
        f"{tmp_path / 'log.xyz'}: unknown log suffix '.xyz'; "
        "expected one of .csv, .mcap, .bag, .db3, none (a folder)"
    )


def test_a_sample_log_is_reproducible(tmp_path: Path) -> None:
    """The commands in `sample_logs/README.md` create the logs.

    Samples agree to 1e-9, because the last bits of a Fourier transform depend on the processor.
    """
    folder = Path(__file__).parents[1] / "sample_logs"
    lines = (folder / "README.md").read_text(encoding="utf-8").splitlines()
    (line,) = [line for line in lines if line.startswith("imucal simulate") and "with_gaps.csv" in line]
    copy = tmp_path / "with_gaps.csv"
    result = CliRunner().invoke(imucal, [*shlex.split(line)[1:-1], str(copy), "--json"])
    assert result.exit_code == 0, result.output
    repeated, kept = (np.loadtxt(path, delimiter=",") for path in (copy, folder / "with_gaps.csv"))
    npt.assert_allclose(repeated, kept, rtol=1e-9, atol=1e-12)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert json.loads(result.stdout) == truth["with_gaps.csv"]
