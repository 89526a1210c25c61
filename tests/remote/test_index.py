"""The description of a remote log, from a part of its bytes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

import imucal
from imucal.readers import describe
from imucal.readers.files import DamagedError
from imucal.readers.remote_logs import RangedFile, TooMuchError
from imucal.remote.copies import fetched
from imucal.remote.stores import identify
from imucal.simulation import write_log
from tests.cli.run import SAMPLE_LOGS
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")


@pytest.mark.parametrize("name", ["consumer_mems.mcap", "tactical.bag"])
def test_the_index_gives_the_same_description(web: WebServer, name: str) -> None:
    """The description equals that of the local file, and nothing is cached."""
    body = (SAMPLE_LOGS / name).read_bytes()
    url = web.add(f"/{name}", body)
    here, there = describe(SAMPLE_LOGS / name), describe(f"{url}?sig=SECRET")
    assert there.path == url
    assert [(t, there.size_bytes, there.start_ns, there.duration_s) for t in there.topics] == [
        (t, here.size_bytes, here.start_ns, here.duration_s) for t in here.topics
    ]
    assert web.sent < 0.8 * len(body)
    assert all(part for _, part, _ in web.asked)


def test_a_cut_log_is_downloaded_and_described(web: WebServer) -> None:
    """The cut log has no index, so the complete file is needed."""
    body = (SAMPLE_LOGS / "consumer_mems.mcap").read_bytes()[:-200_000]
    contents = describe(web.add("/cut.mcap", body))
    assert [finding.code for finding in contents.findings] == ["truncated"]
    assert contents.topics[0].count


def test_a_server_without_ranges_sends_the_file_once(web: WebServer) -> None:
    body = (SAMPLE_LOGS / "tactical.bag").read_bytes()
    contents = describe(web.add("/tactical.bag", body, ranges=False))
    assert contents.topics[0].count == 24000
    assert [part for _, part, _ in web.asked] == ["bytes=0-511", ""]


def test_a_cached_log_is_described_without_requests(web: WebServer) -> None:
    url = web.add("/tactical.bag", (SAMPLE_LOGS / "tactical.bag").read_bytes())
    with fetched(url):
        pass
    before = web.sent
    assert describe(url).topics[0].count == 24000
    assert web.sent == before + 512


def test_parts_equal_the_bytes_of_the_file(web: WebServer) -> None:
    """Parts have any place, length and order; each block is requested once."""
    body = np.random.default_rng(14).bytes(3_000_000)
    remote = identify(web.add("/log", body)).files[0]
    rng = np.random.default_rng(15)
    with_ends = [(0, 1), (len(body) - 1, 1), (0, 0), (len(body), 0), (131071, 2)]
    file = RangedFile(remote, SAMPLE_LOGS)
    anywhere = [(int(rng.integers(2_500_000)), int(rng.integers(400_000))) for _ in range(30)]
    for start, size in with_ends + anywhere:
        assert file.read(start, size) == body[start : start + size]
    assert file.fetched <= len(body)
    for start, size in ((len(body), 1), (-1, 5), (0, len(body) + 1)):
        with pytest.raises(DamagedError):
            file.read(start, size)


def test_reading_more_than_a_quarter_by_parts_is_refused(web: WebServer) -> None:
    """The limit applies to files from 4 MB on."""
    remote = identify(web.add("/log", bytes(40_000_000))).files[0]
    file = RangedFile(remote, SAMPLE_LOGS)
    file.read(0, 9_900_000)
    with pytest.raises(TooMuchError):
        file.read(20_000_000, 300_000)


def test_a_bag_of_mcap_files_is_described_by_their_indexes(web: WebServer, tmp_path: Path) -> None:
    """The folder has ROS 2 metadata, and one part is missing."""
    recording = imucal.read(SAMPLE_LOGS / "consumer_mems.mcap")
    names = [f"bag_{i}.mcap" for i in (0, 1, 10)]
    bag = tmp_path / "bag"
    bag.mkdir()
    for i, name in enumerate(names[:2]):
        write_log(recording.between(350.0 * i, 350.0 * (i + 1)), bag / name)
    listed = "".join(f"    - {name}\n" for name in names)
    (bag / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}", encoding="utf-8"
    )
    for path in bag.iterdir():
        web.add(f"/run/bag/{path.name}", path.read_bytes())
    links = "".join(f"<a href='{path.name}'>x</a>" for path in bag.iterdir())
    web.add("/run/bag/", links.encode(), kind="text/html")
    here, there = describe(bag), describe(f"{web.url}/run/bag/")
    assert there.path == f"{web.url}/run/bag"
    assert [f.code for f in there.findings] == ["file-missing"]
    assert replace(there, path=here.path) == here
    assert web.sent < 0.8 * sum(path.stat().st_size for path in bag.iterdir())
    npt.assert_array_equal(
        imucal.read(f"{web.url}/run/bag/").series[0].samples, imucal.read(bag).series[0].samples
    )
