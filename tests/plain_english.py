"""Count awkward constructions in comments, docstrings, messages and docs.

The count is a thermometer: a sentence without any of them can still be bad.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

__all__ = ["awkward", "counts"]

ROOT = Path(__file__).parents[1]
#: Clauses instead of nouns; things that speak or stand; pronouns without a noun; rare words.
_CLAUSE = (
    r"(?:^|[.;:(,] |\b(?:of|by|from|for|in|to|with|and|than|as|is|are|says?|tells?|shows?|holds?) )"
    r"(?:what|who|whoever|whatever)\b"
)
_SPEAKS = r"\b(?:says?|said|tells?|told|speaks?|asks?|knows?|stands?|stood|lies|lie)\b"
_PRONOUN = (
    r"\b(?:that of|those of|that which|those that|the one that|one that|of which|of it|of them|such a"
    r"|so many|so much|as many as)\b"
)
_RARE = r"\b(?:anew|mended?|mends|graver|nought|hence|thereby|slips?|beside|till|lest|whence|likewise|else)\b"
_AWKWARD = re.compile(f"{_CLAUSE}|{_SPEAKS}|{_PRONOUN}|{_RARE}", re.IGNORECASE | re.MULTILINE)
#: Texts of fewer words are names, not messages.
_FEWEST_WORDS = 4


def awkward(text: str) -> int:
    """Return the number of awkward constructions in a text."""
    return len(_AWKWARD.findall(text))


def counts() -> dict[str, int]:
    """Return the number of awkward constructions in comments, messages and docs."""
    code = messages = 0
    for path in sorted((ROOT / "imucal").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        docstrings = {id(node): value for node, value in _docstrings(tree)}
        code += sum(map(awkward, docstrings.values())) + sum(map(awkward, _comments(text)))
        messages += sum(
            awkward(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docstrings
            and len(node.value.split()) >= _FEWEST_WORDS
        )
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    return {"code": code, "messages": messages, "docs": sum(awkward(p.read_text("utf-8")) for p in pages)}


def _docstrings(tree: ast.Module) -> Iterator[tuple[ast.expr, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and (text := ast.get_docstring(node)):
                yield first.value, text


def _comments(text: str) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("#: ")
