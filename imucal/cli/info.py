"""``imucal info``: what is in a log, from its index; gaps and clocks where the log is small."""

from imucal.cli._declared import declared, flag, option
from imucal.cli._info import SCHEMA, lines_of_log, log_document, read_topics
from imucal.cli._printing import echo, print_json, wrapped
from imucal.cli._progress import download_progress
from imucal.cli.parameters import READING, Asked
from imucal.readers import LogContents, describe, logs_of
from imucal.readers.read_options import options_of
from imucal.readers.tables.text_source import STANDARD_INPUT
from imucal.remote import is_url
from imucal.remote.addresses import shown

#: When several logs are read as one.
_JOINED_WHERE = "Together they are read only where each goes on where the one before ends, or with --join."
#: Logs up to this size are read in full without being asked, in bytes: it takes less than a second.
_SMALL = 1 << 26
#: The same of logs behind a URL, which are downloaded for it.
_SMALL_REMOTE = 1 << 20
#: And up to so many samples, however well they are packed.
_MANY = 4_000_000


@declared(
    epilog="""\b
Examples:
  imucal info log.mcap
  imucal info --gaps 20h.bag
  imucal info 's3://bucket/run/*.mcap'
  imucal info -v --msg MyImu.msg old.db3
  imucal info --json *.mcap | jq '.logs[].topics[].rate_hz'

\b
Exit codes: 0 done, 2 usage, 3 a log can't be read."""
)
def command(
    *,
    as_json: bool = flag("--json", "Print JSON on standard output."),
    gaps: bool | None = option(
        "--gaps/--no-gaps",
        "Read the samples too, to find gaps and what is wrong with clocks (default: logs up to 64 MB).",
        default=None,
    ),
    asked: Asked = READING,
    verbose: bool = flag("-v --verbose", "List the fields of messages too."),
) -> None:
    """Say what is in each LOG: topics, types, counts, rates, duration, units, gaps."""
    entries, (logs, reading) = [], asked
    folders = {named: parts for named in logs if len(parts := logs_of(named)) > 1}
    for log in (log for named in logs for log in folders.get(named, [named])):
        with download_progress(quiet=not is_url(log)) as progress:
            contents = describe(log, options_of(progress=progress, **reading))
        small = contents.size_bytes is not None and _is_small(contents, remote=is_url(log))
        # Standard input is gone once it was described.
        wanted = (small if gaps is None else gaps) and log != STANDARD_INPUT
        found = read_topics(log, contents, reading) if wanted else {}
        if as_json:
            entries.append(log_document(contents, found))
        else:
            echo("\n".join(lines_of_log(contents, found, looked=wanted, verbose=verbose)))
    for folder, parts in folders.items() if not as_json else ():
        text = f"{shown(folder)}: {len(parts)} logs without a metadata.yaml that says they are one recording."
        echo("\n".join([*wrapped(f"{text} {_JOINED_WHERE}"), ""]))
    if as_json:
        print_json({"schema": SCHEMA, "logs": entries}, ascii_only=False)


def _is_small(contents: LogContents, *, remote: bool) -> bool:
    """Return whether a log is read without being asked: a few bytes may hold very many samples."""
    most = _SMALL_REMOTE if remote else _SMALL
    samples = sum(topic.count or 0 for topic in contents.imu_topics)
    size = max(contents.size_bytes or 0, contents.unpacked_bytes or 0)
    return size <= most and samples <= _MANY
