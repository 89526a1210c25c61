"""Compare reports of two versions: models, findings, estimates and limits.

    python tests/benchmarks/same_results.py before/ after/

Both folders contain the output of ``imucal fit LOG --json`` under equal names. An estimate and its limits
must be within 1 % of the interval's width of the earlier ones. The exit code is 1 if anything differs.
"""

import json
import sys
from pathlib import Path
from typing import Any

#: Largest change of an estimate or a limit, as a share of its interval's width.
_MOST = 0.01


def moves(before: dict[str, Any], after: dict[str, Any]) -> dict[str, float]:
    """Return the change of each estimate in widths of its earlier interval; inf if its kind changed."""
    found = {}
    for key in before.keys() | after.keys():
        old, new = before.get(key), after.get(key)
        if old is None or new is None:
            found[key] = float("inf")
            continue
        width = (old["high"] - old["low"]) or abs(old["high"]) or 1.0
        pairs = [(old[name], new[name]) for name in ("value", "low", "high")]
        found[key] = max(
            0.0 if a == b else float("inf") if a is None or b is None else abs(a - b) / width
            for a, b in pairs
        )
        if old.get("T") and new.get("T"):
            found[f"{key}.T"] = moves({"T": old["T"]}, {"T": new["T"]})["T"]
    return found


def keys_of(findings: list[dict[str, Any]]) -> set[tuple[str, str, str]]:
    """Return level, code and axis of each finding."""
    return {(finding["level"], finding["code"], finding["axis"] or "") for finding in findings}


def differences(before: dict[str, Any], after: dict[str, Any]) -> tuple[float, list[str]]:
    """Return the largest change, in widths, and descriptions of the differences."""
    lines = []
    largest = 0.0
    axes = {axis["name"]: axis for axis in after["axes"]}
    findings_before = keys_of(before["findings"])
    findings_after = keys_of(after["findings"])
    if findings_before != findings_after:
        lines.append(f"findings {sorted(findings_before ^ findings_after)}")
    for old in before["axes"]:
        new = axes.pop(old["name"], None)
        if new is None:
            lines.append(f"{old['name']}: gone")
            continue
        if old["fit"]["model"] != new["fit"]["model"]:
            lines.append(f"{old['name']}: {old['fit']['model']} became {new['fit']['model']}")
            continue
        for key, move in moves(old["fit"]["terms"], new["fit"]["terms"]).items():
            largest = max(largest, move)
            if move > _MOST:
                lines.append(f"{old['name']}: {key} moved by {move:.3g} widths")
    lines += [f"{name}: new" for name in axes]
    return largest, lines


def main() -> None:
    """Print a table in Markdown, followed by the differences."""
    first, second = (Path(text) for text in sys.argv[1:3])
    everything = []
    print("| log | axes | largest move, % of the interval | differences |")
    print("|---|---|---|---|")
    for path in sorted(first.glob("*.json")):
        files = [folder / path.name for folder in (first, second)]
        texts = [file.read_text(encoding="utf-8") if file.exists() else "" for file in files]
        if not all(texts):
            same = texts[0] == texts[1]
            print(f"| {path.stem} | – | – | {'no report either time' if same else 'one has no report'} |")
            everything += [] if same else [path.stem]
            continue
        before, after = map(json.loads, texts)
        if "axes" not in before or "axes" not in after:
            everything += [] if before == after else [path.stem]
            print(f"| {path.stem} | – | – | {'same error' if before == after else 'another error'} |")
            continue
        largest, lines = differences(before, after)
        everything += [f"{path.stem}: {line}" for line in lines]
        print(f"| {path.stem} | {len(before['axes'])} | {100 * largest:.3g} | {len(lines)} |")
    print("\n".join(everything))
    sys.exit(1 if everything else 0)


if __name__ == "__main__":
    main()
