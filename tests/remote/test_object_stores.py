"""Logs in object stores: S3, simulated by moto on this machine."""

import importlib.util
import re
import tomllib
from pathlib import Path
from typing import Any

import fsspec
import numpy.testing as npt
import pytest

import imucal
from imucal.errors import ReadError
from imucal.readers import describe, logs_of
from imucal.readers.containers.rosbag2_folder import ENDINGS
from imucal.readers.formats import FORMATS
from imucal.remote import stores
from imucal.remote.addresses import PACKAGES
from imucal.remote.copies import fetched
from imucal.remote.stores import _MESSAGES, _TABLES, EXTRAS, expand, identify
from imucal.simulation import write_log
from tests.cli.run import SAMPLE_LOGS, run
from tests.raising import raises
from tests.remote.one_axis import OPTIONS, one_axis
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["consumer_mems.mcap", "tactical.bag"])
def test_a_log_in_s3_equals_the_local_log(bucket: Any, name: str) -> None:  # noqa: ANN401
    """Samples are equal. The recording contains the URL as path and the ETag of the object."""
    bucket.put_file(SAMPLE_LOGS / name, f"logs/run/{name}")
    url = f"s3://logs/run/{name}"
    here, there = imucal.read(SAMPLE_LOGS / name), imucal.read(url, checksums=True)
    for a, b in zip(here.series, there.series, strict=True):
        npt.assert_array_equal(a.samples, b.samples)
    assert there.source.path == url
    assert [(file.path, file.etag) for file in there.source.files] == [(url, bucket.info(url)["ETag"])]
    assert describe(url).topics == describe(SAMPLE_LOGS / name).topics


def test_a_log_in_s3_is_downloaded_in_parts(bucket: Any, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ANN401
    """The last part is shorter."""
    monkeypatch.setattr(stores, "PART", 1000)
    body = bytes(range(256)) * 10
    bucket.pipe_file("logs/a.csv", body)
    with fetched(identify("s3://logs/a.csv")) as copy:
        assert copy.path.read_bytes() == body


def test_a_changed_object_is_downloaded_again(bucket: Any) -> None:  # noqa: ANN401
    """The process must not cache listings."""
    bucket.pipe_file("logs/a.csv", b"one")
    with fetched(identify("s3://logs/a.csv")) as copy:
        assert copy.path.read_bytes() == b"one"
    bucket.pipe_file("logs/a.csv", b"two")
    with fetched(identify("s3://logs/a.csv")) as copy:
        assert copy.path.read_bytes() == b"two"


def test_a_bag_with_metadata_is_one_log(bucket: Any, tmp_path: Path) -> None:  # noqa: ANN401
    """The log is a ROS 2 folder; its local parts belong together too."""
    recording = imucal.read(SAMPLE_LOGS / "tactical.bag")
    write_log(recording.between(0, 20), tmp_path / "bag")
    bucket.put(str(tmp_path / "bag"), "logs/bag", recursive=True)
    for url in ("s3://logs/bag", "s3://logs/bag/"):
        assert expand(url) == [url]
        there = imucal.read(url, checksums=True)
        assert there.source.path == "s3://logs/bag"
        assert there.source.format == "rosbag2-sqlite3"
        npt.assert_array_equal(there.series[0].samples, imucal.read(tmp_path / "bag").series[0].samples)
        files = [file.path for file in there.source.files]
        assert files == ["s3://logs/bag/bag.db3", "s3://logs/bag/metadata.yaml"]
        assert describe(url).path == "s3://logs/bag"
    assert identify("s3://logs/bag").size == sum(path.stat().st_size for path in (tmp_path / "bag").iterdir())


def test_parts_of_one_recording_are_joined(bucket: Any, tmp_path: Path) -> None:  # noqa: ANN401
    """Wildcards or a folder select them in natural order, as for local files."""
    recording = imucal.read(SAMPLE_LOGS / "consumer_mems.mcap")
    for name, start in (("a_9.mcap", 0.0), ("a_10.mcap", 60.0)):
        write_log(recording.between(start, start + 60), tmp_path / name)
        bucket.put_file(tmp_path / name, f"logs/split/{name}")
    for url in ("s3://logs/split/a_*.mcap", "s3://logs/split", "s3://logs/*/*.mcap"):
        assert logs_of(url) == ["s3://logs/split/a_10.mcap", "s3://logs/split/a_9.mcap"]
        joined = imucal.read(url)
        npt.assert_array_equal(joined.series[0].samples, recording.between(0, 120).series[0].samples)
        assert joined.source.path == "s3://logs/split/a_9.mcap, s3://logs/split/a_10.mcap"
    bucket.copy("logs/split/a_9.mcap", "logs/split/b_9.mcap")
    with raises(ReadError, "3 logs do not look like one", place="s3://logs/split/a_9.mcap", argument="join"):
        imucal.read("s3://logs/split")


def test_a_name_may_contain_wildcard_characters(bucket: Any) -> None:  # noqa: ANN401
    """A pattern without matches is used as a name."""
    bucket.pipe_file("logs/run[1].csv", b"t,gx\n")
    assert expand("s3://logs/run[1].csv") == ["s3://logs/run[1].csv"]
    with raises(ReadError, "no log has this name", place="s3://logs/run[2].csv"):
        expand("s3://logs/run[2].csv")


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("s3://logs/none.mcap", "there is no such object (404); check the address"),
        ("s3://other/none.mcap", "there is no such bucket (404); check the address"),
        ("s3://logs/notes", "a folder with a.md; expected logs, such as .mcap, .bag or .csv files"),
    ],
)
def test_a_missing_object_bucket_or_log_is_reported(bucket: Any, url: str, message: str) -> None:  # noqa: ANN401
    bucket.pipe_file("logs/notes/a.md", b"dear")
    with pytest.raises(ReadError, match=re.escape(f"{url}: {message}")) as error:
        imucal.read(url)
    assert error.value.exit_code == 3


def test_missing_credentials_are_reported_with_a_solution(
    bucket: Any,  # noqa: ANN401
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A public bucket needs none."""
    bucket.pipe_file("logs/a.csv", b"one")
    bucket.chmod("logs/a.csv", "public-read")
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    bucket.clear_instance_cache()
    message = "s3://logs/a.csv: no credentials, or wrong ones; set AWS_PROFILE, or AWS_ACCESS_KEY_ID"
    with pytest.raises(ReadError, match=re.escape(message)):
        imucal.read("s3://logs/a.csv")
    conf: dict[str, dict[str, object]] = {}
    # fsspec reads the variable only when it is loaded, which is already done.
    fsspec.config.set_conf_env(conf, {"FSSPEC_S3_ANON": "true"})
    monkeypatch.setitem(fsspec.config.conf, "s3", conf["s3"])
    with fetched(identify("s3://logs/a.csv")) as copy:
        assert copy.path.read_bytes() == b"one"
    bucket.clear_instance_cache()


def test_denied_access_and_unreachable_servers_are_reported(
    bucket: Any,  # noqa: ANN401
    web: WebServer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A request with status 403 is not repeated; one without an answer is."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", web.url)
    bucket.clear_instance_cache()
    with raises(ReadError, r"access is denied \(403\)", place="s3://logs/a.csv"):
        imucal.read("s3://logs/a.csv")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    bucket.clear_instance_cache()
    monkeypatch.setattr(stores, "WAITS", (0.0,))
    with raises(ReadError, r"\(2 attempts\)", place="s3://logs/a.csv"):
        imucal.read("s3://logs/a.csv")
    bucket.clear_instance_cache()


@pytest.mark.parametrize("scheme", PACKAGES)
def test_a_missing_extra_is_reported_with_the_install_command(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra exists and contains the package."""
    find = importlib.util.find_spec
    package = PACKAGES[scheme]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find(name))
    with pytest.raises(ReadError) as error:
        imucal.read(f"{scheme}://bucket/log.mcap")
    match = re.fullmatch(
        rf"{scheme}://bucket/log\.mcap: needs another package; type: pip install '(.*)\[(.*)\]'",
        str(error.value),
    )
    assert match
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert match[1] == project["name"]
    assert match[2] == EXTRAS[package]
    assert project["optional-dependencies"][match[2]][0].startswith(f"{package}>=")


def test_remote_folders_accept_the_extensions_of_all_formats() -> None:
    """The list must equal that of the readers."""
    messages = {suffix for entry in FORMATS if entry.messages for suffix in entry.suffixes}
    assert set(_MESSAGES) == messages | set(ENDINGS)
    assert set(_TABLES) == {suffix for entry in FORMATS if not entry.messages for suffix in entry.suffixes}


def test_every_command_accepts_a_url(bucket: Any, tmp_path: Path) -> None:  # noqa: ANN401
    """Outputs contain the URL, and files are named after the log."""
    bucket.pipe_file("logs/short.csv", one_axis())
    url = "s3://logs/short.csv"
    quick = ["-q", *OPTIONS]
    fit = run("fit", url, "--model", "N", "--no-report", "--json", *quick, cwd=tmp_path)
    assert fit.returncode == 0, fit.stderr
    (tmp_path / "report.json").write_text(fit.stdout, encoding="utf-8")
    assert run("adev", url, *quick, cwd=tmp_path).stdout.startswith("axis,tau,m,adev")
    info = run("info", url, *OPTIONS, cwd=tmp_path).stdout
    assert info.startswith(url)
    assert "1500 samples, no gaps" in info
    done = run("decompose", url, "--model", "N", *quick, cwd=tmp_path)
    assert (done.returncode, (tmp_path / "short-decomposed" / "gyro_z.csv").exists()) == (0, True), (
        done.stderr
    )
    (tmp_path / "limits.toml").write_text("[gyroscope]\nN = { max = 1.0 }\n", encoding="utf-8")
    checked = run("check", url, "--limits", "limits.toml", *quick, cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    bucket.put_file(tmp_path / "report.json", "logs/report.json")
    same = run("compare", "s3://logs/report.json", "report.json", cwd=tmp_path)
    assert "no significant difference" in same.stdout, same.stderr
    planned = run("plan", "s3://logs/report.json", "-q", cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    checked = run("check", "report.json", "--baseline", "s3://logs/report.json", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    refused = run("compare", url, "report.json", cwd=tmp_path)
    assert (refused.returncode, url in refused.stderr) == (3, True)
