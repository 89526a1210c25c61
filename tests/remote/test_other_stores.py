"""Logs in the stores of Google and Azure, if gcsfs and adlfs are installed."""

import pytest

from imucal.errors import ReadError
from imucal.remote.copies import fetched
from imucal.remote.stores import expand, identify
from tests.remote.cloud_servers import cloud_server
from tests.remote.one_axis import one_axis

pytestmark = pytest.mark.usefixtures("cache", "no_waits")


@pytest.mark.parametrize(("scheme", "package"), [("gs", "gcsfs"), ("az", "adlfs"), ("abfs", "adlfs")])
def test_a_log_in_google_or_azure_is_read(scheme: str, package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test checks identity, bytes, names, wildcards and missing objects."""
    with cloud_server(one_axis()) as environment:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        library = pytest.importorskip(package, reason=f"{package} is part of an extra")
        # The package is loaded here, because it reads the environment when loaded.
        fsspec = pytest.importorskip("fsspec")
        if package == "gcsfs":
            monkeypatch.setitem(fsspec.config.conf, "gs", {"token": "anon"})
        url = f"{scheme}://bucket/run/a.csv"
        log = identify(url)
        assert log.etag.strip('"') in {"CJ9=", "0x8D"}
        assert log.size == len(one_axis())
        with fetched(log) as copy:
            assert copy.path.read_bytes() == one_axis()
        assert expand(f"{scheme}://bucket/run/*.csv") == [url]
        with pytest.raises(
            ReadError, match=rf"{scheme}://bucket/run/none\.csv: there is no such object \(404\)"
        ):
            identify(f"{scheme}://bucket/run/none.csv")
        assert library


def test_azure_without_an_account_is_reported_with_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("adlfs", reason="adlfs is part of an extra")
    for name in ("AZURE_STORAGE_CONNECTION_STRING", "AZURE_STORAGE_ACCOUNT_NAME"):
        monkeypatch.delenv(name, raising=False)
    message = r"az://other/a\.csv: no credentials, or wrong ones; set AZURE_STORAGE_ACCOUNT_NAME"
    pytest.importorskip("fsspec").get_filesystem_class("az").clear_instance_cache()
    with pytest.raises(ReadError, match=message):
        identify("az://other/a.csv")
