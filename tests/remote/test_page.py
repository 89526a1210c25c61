"""The page about remote logs: its commands run, and it says what the program says."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import imucal
from imucal.log_files import write_log
from tests.cli.run import SAMPLE_LOGS, run
from tests.code_blocks import code_blocks
from tests.remote.one_axis import one_axis
from tests.remote.web_server import WebServer
from tests.test_docs_pages import says, texts

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "remote-logs.md"


def typed(page: Path) -> list[str]:
    """Return the lines of the page that a shell takes."""
    return [line for language, text in code_blocks(page) if language == "sh" for line in text.splitlines()]


def test_the_commands_of_the_page_run(
    bucket: Any,  # noqa: ANN401
    web: WebServer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With the sample logs in a bucket and behind a web server."""
    if not bucket.exists("lab"):
        bucket.mkdir("lab")
    bucket.put_file(SAMPLE_LOGS / "tactical.bag", "lab/monday/tactical.bag")
    recording = imucal.read(SAMPLE_LOGS / "tactical.bag")
    bucket.pipe_file("lab/monday/still.csv", one_axis())
    write_log(recording.between(0, 10), tmp_path / "bag")
    bucket.put(str(tmp_path / "bag"), "lab/bag", recursive=True)
    web.add("/with_gaps.csv", (SAMPLE_LOGS / "with_gaps.csv").read_bytes())
    for line in typed(PAGE):
        program, *words = shlex.split(line.replace("https://logs.example.org", web.url))
        if program == "python":
            exec(compile(words[-1], "the page", "exec"), {})  # noqa: S102 - our own page
            assert float(capsys.readouterr().out) == pytest.approx(100, rel=1e-3)
            continue
        words = words[: words.index(">")] if ">" in words else words
        done = run(*words, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr}"
        assert "0815" not in done.stdout + done.stderr
    assert (tmp_path / "monday" / "report.json").exists()


def test_the_page_quotes_what_is_said() -> None:
    """Each message, in the words of the source."""
    messages = re.findall(
        r"^\| `([^`]+)` \| [^|]* \| [^|]* \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    messages = [message for message in messages if not message.startswith("IMUCAL")]
    assert len(messages) >= 10
    said = [text for text in texts() if len(text) > 12]
    assert [message for message in messages if not any(says(message, text) for text in said)] == []
