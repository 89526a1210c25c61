"""Logs of messages: files whose topics are tables."""

from collections.abc import Sequence
from pathlib import Path

from imucal.errors import Fix
from imucal.findings import Finding
from imucal.readers.containers.container import Container, Loss, OpenFiles
from imucal.readers.files import naming, refused
from imucal.readers.memory import fit_into_memory, too_large
from imucal.readers.messages.loader import MIN_MESSAGE_BYTES, Decoding, Stream, decode
from imucal.readers.messages.topics import Number, Topic, find_topics
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import Loaded, Log, Request, Table

#: Time read before and after a part, in s, because log times are later than stamps.
_MARGIN_S = 10.0
#: Most topics of a log; finding the sensors of one takes 1 ms.
_MAX_TOPICS = 5000


class MessageLog(Log):
    """The files of a log of messages."""

    def __init__(self, path: Path, containers: Sequence[Container], form: str, options: ReadOptions) -> None:
        super().__init__(path)
        self.form = form
        self._containers = containers
        self._options = options
        try:
            _refuse_many_topics(path, containers)
            with naming(path):
                topics = find_topics(containers, options)
        except BaseException:
            self.close()
            raise
        self.tables = [topic.table(containers, options) for topic in topics]
        self._topics = dict(zip(self.tables, topics, strict=True))
        self.findings = [finding for container in containers for finding in container.findings]
        self.size_bytes = sum(container.size for container in containers)
        self.compression = ", ".join(sorted({container.compression for container in containers}))
        starts = [one.start_ns for one in containers if one.start_ns is not None]
        ends = [one.end_ns for one in containers if one.end_ns is not None]
        self.start_ns = min(starts, default=None)
        self.end_ns = max(ends, default=None)

    @property
    def containers(self) -> Sequence[Container]:
        """The files of the log."""
        return self._containers

    def numbers_of(self, table: Table, indices: Sequence[int]) -> list[Number]:
        """Return the numbers in messages that are columns of a table."""
        topic = self._topics[table]
        return [topic.numbers[index] for index in indices]

    def stream_of(self, table: Table, indices: Sequence[int]) -> Stream:
        """Return the decoders of some columns of a table, in their order; raises ReadError."""
        return self._topics[table].stream(self.numbers_of(table, indices))

    def close(self) -> None:
        for container in self._containers:
            container.close()

    def read(self, requests: Sequence[Request]) -> list[Loaded]:
        wanted = [self._numbers(request) for request in requests]
        topics = [self._topics[request.table] for request in requests]
        with naming(self.path):
            streams = [
                topic.stream([topic.numbers[index] for index in indices])
                for topic, indices in zip(topics, wanted, strict=True)
            ]
            part = self._part(requests)
            decodings = decode(self._containers, streams, progress=self._options.progress, between_ns=part)
        if part is not None:
            firsts = [int(one.columns[0][0]) for one in decodings if one.columns[0].size]
            self.left_out_s = (min(firsts, default=part[0]) - self._first_ns(requests)) / 1e9
        return [
            self._loaded(request, topic, indices, decoding)
            for request, topic, indices, decoding in zip(requests, topics, wanted, decodings, strict=True)
        ]

    def _part(self, requests: Sequence[Request]) -> tuple[int, int] | None:
        """Return the times of the part to read, in ns, if the whole does not fit into memory.

        Raises DataError if the part does not fit either, or if none is asked for.
        """
        # Counts can be wrong, so the size of the files limits them.
        most = (self.size_bytes or 0) // MIN_MESSAGE_BYTES
        counts = [min(request.table.count or 0, most) for request in requests]
        columns = [1 + len(request.columns) for request in requests]
        values = sum(count * width for count, width in zip(counts, columns, strict=True))
        if fit_into_memory(values):
            return None
        first_ns = self._first_ns(requests)
        duration_s = max(request.table.duration_s or 0.0 for request in requests)
        start_s = max(self._options.skip_s - _MARGIN_S, 0.0)
        end_s = min(self._options.end_s + _MARGIN_S, duration_s + 1)
        share = max(end_s - start_s, 0.0) / duration_s if duration_s else 1.0
        if not self._options.is_part or not fit_into_memory(round(share * values)):
            fixes = [Fix("read a part of it", "take_s", "TIME"), Fix("", "skip_s", "TIME")]
            raise too_large(self.path, values, *fixes)
        return first_ns + round(start_s * 1e9), first_ns + round(end_s * 1e9)

    def _first_ns(self, requests: Sequence[Request]) -> int:
        return min((one.table.first_ns for one in requests if one.table.first_ns is not None), default=0)

    def _numbers(self, request: Request) -> list[int]:
        """Return the indices of the columns to decode; the log time is always decoded."""
        indices = [*request.columns, *([request.rows[0]] if request.rows else [])]
        return list(dict.fromkeys(index for index in indices if index != request.table.log_time))

    def _loaded(self, request: Request, topic: Topic, indices: Sequence[int], decoding: Decoding) -> Loaded:
        log_ns, *columns = decoding.columns
        findings = _loss_findings(decoding.losses, decoding.missing) + _count_findings(topic, decoding)
        if not log_ns.size:
            texts = [loss.text for loss in decoding.losses] + [one.text for one in self.findings + findings]
            why = next(iter(texts), "the log has none")
            raise refused(self.path, f"no message of topic {topic.name} could be read: {why}")
        found = dict(zip(indices, columns, strict=True))
        found[len(topic.numbers)] = log_ns
        if request.rows is not None:
            keep = found[request.rows[0]] == float(request.rows[1])
            found = {index: column[keep] for index, column in found.items()}
        return Loaded(found, findings)


def open_messages(path: Path, options: ReadOptions, open_files: OpenFiles) -> MessageLog:
    """Open a log whose format has the function `open_files`; raises ReadError if it can't be read."""
    containers, form = open_files(path, options.progress)
    return MessageLog(path, containers, form, options)


def _refuse_many_topics(path: Path, containers: Sequence[Container]) -> None:
    n = max((len(container.channels) for container in containers), default=0)
    if n > _MAX_TOPICS:
        way = "copy those of the IMU to another log, such as with `mcap filter` or `ros2 bag convert`"
        raise refused(path, f"it contains {n} topics; expected at most {_MAX_TOPICS}; {way}")


def _loss_findings(losses: Sequence[Loss], missing: int | None) -> list[Finding]:
    """Return one finding per kind of loss; `missing` messages are in unreadable parts."""
    findings = []
    unread = {loss.code for loss in losses if loss.messages is None}
    for code in dict.fromkeys(loss.code for loss in losses):
        same = [loss for loss in losses if loss.code == code]
        where = f"{len(same)} places" if len(same) > 1 else "one place"
        lost = sum(loss.messages or 0 for loss in same)
        if code not in unread:
            count = _lost(lost)
        elif missing is None:
            count = "the number of lost messages is unknown"
        else:
            # The count does not distinguish the reasons.
            count = _lost(lost + missing) if len(unread) == 1 else f"{_lost(missing)} in all unreadable parts"
        text = f"The log is damaged in {where}: {same[0].text}; {count}."
        findings.append(Finding("warning", code, text))
    return findings


def _count_findings(topic: Topic, decoding: Decoding) -> list[Finding]:
    """Return a finding if the log counts more messages of a topic than were found or reported as lost."""
    reported = [loss.messages for loss in decoding.losses]
    if decoding.missing is None or None in reported:
        return []
    lost = decoding.missing - sum(number or 0 for number in reported)
    if lost <= 0:
        return []
    text = f"The log counts {topic.count} messages of topic {topic.name}, and {lost} of them were not found."
    return [Finding("warning", "damaged", text, "Copy the log again.")]


def _lost(n: int) -> str:
    return f"about {n} messages are lost" if n else "no message is lost"
