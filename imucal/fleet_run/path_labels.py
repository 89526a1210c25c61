"""Labels of a log from its path, by a pattern such as ``{model}/{unit}/{temperature_c}C/*.mcap``."""

import re

#: Parts of a pattern that stand for other text: labels, and wildcards as in the names of files.
_PART = re.compile(r"\{(?P<label>[^{}]*)\}|(?P<any>\*\*/?)|(?P<some>\*)|(?P<one>\?)|(?P<brace>[{}])")
_LABEL = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WILD = {"any": ".*", "some": "[^/]*", "one": "[^/]"}


class LabelPattern:
    """A pattern of paths with labels in braces.

    It is held against the end of a path, from any folder on; a label is as short as it can be.

    Raises
    ------
    ValueError
        If it has no label, one twice, or a brace alone.
    """

    def __init__(self, pattern: str) -> None:
        self.pattern = pattern
        self.labels: list[str] = []
        body = ""
        end = 0
        for part in _PART.finditer(pattern):
            body += re.escape(pattern[end : part.start()]) + self._expression(part)
            end = part.end()
        if not self.labels:
            msg = f"labels {pattern!r}: no label; write such as '{{model}}/{{unit}}/*.mcap'"
            raise ValueError(msg)
        self._regex = re.compile(f"(?:^|.*/){body}{re.escape(pattern[end:])}$")

    def _expression(self, part: re.Match[str]) -> str:
        if part["brace"]:
            msg = f"labels {self.pattern!r}: a brace alone; write such as '{{model}}/{{unit}}/*.mcap'"
            raise ValueError(msg)
        if part["label"] is None:
            return _WILD[part.lastgroup or ""]
        label = part["label"]
        if not _LABEL.fullmatch(label) or label in {"path", "options", "copy_of"}:
            msg = f"labels {self.pattern!r}: {label!r} is no name of a label; write such as {{unit}}"
            raise ValueError(msg)
        if label in self.labels:
            msg = f"labels {self.pattern!r}: {label!r} stands twice; give each label a name of its own"
            raise ValueError(msg)
        self.labels.append(label)
        return f"(?P<{label}>[^/]+?)"

    def of(self, path: str) -> dict[str, str] | None:
        """Return the labels of a path; None where the pattern does not fit."""
        found = self._regex.match(path.replace("\\", "/"))
        return found.groupdict() if found else None
