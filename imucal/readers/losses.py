"""What damaged chunks add up to, as findings."""

from collections.abc import Sequence

from imucal.findings import Finding
from imucal.readers.containers.batch import Loss

#: Codes of findings that say a log is damaged.
DAMAGE = frozenset({"truncated", "unindexed", "crc", "damaged", "index", "compression", "encapsulation",
                    "definition"})  # fmt: skip


def loss_findings(losses: Sequence[Loss]) -> list[Finding]:
    """Return one finding for each kind of loss."""
    findings = []
    for code in dict.fromkeys(loss.code for loss in losses):
        same = [loss for loss in losses if loss.code == code]
        lost = sum(loss.messages or 0 for loss in same)
        places = f"{len(same)} places" if len(same) > 1 else "one place"
        text = f"The log is damaged in {places}: {same[0].text}"
        text += f"; about {lost} messages are lost." if lost else "; no message is lost by it."
        findings.append(Finding(level="warning", code=code, text=text))
    return findings
