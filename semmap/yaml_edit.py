"""Numbers put into a YAML file that somebody wrote by hand: comments, order and layout of the rest stay."""

from __future__ import annotations

from collections.abc import Mapping

import yaml

Edit = tuple[int, int, str]
"""Begin and end in the text, and what comes there."""


def with_values(text: str, block: str, values: Mapping[str, float]) -> str:
    """``text`` with the numbers of one top-level mapping set; keys that are not there yet come after its last one.

    Raises `ValueError` where there is no such mapping, or it is empty.
    """
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    node = next((value for key, value in pairs if key.value == block), None)
    if not isinstance(node, yaml.MappingNode) or not node.value:
        raise ValueError(f"has no mapping `{block}` with keys")
    present = {key.value: value for key, value in node.value}
    edits: list[Edit] = [
        (present[name].start_mark.index, present[name].end_mark.index, _number(value))
        for name, value in values.items()
        if name in present
    ]
    added = [f"{name}: {_number(value)}" for name, value in values.items() if name not in present]
    if added:
        edits.append(_appended(text, node, added))
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _appended(text: str, node: yaml.MappingNode, added: list[str]) -> Edit:
    """New ``key: value`` entries after the last of a mapping, in its own layout."""
    first_key, last_value = node.value[0][0], node.value[-1][1]
    if node.flow_style:
        end = last_value.end_mark.index
        return end, end, "".join(f", {entry}" for entry in added)
    # behind what stands on the line of the last value, its comment included
    end = text.find("\n", _last_character(text, last_value.end_mark.index))
    indent = "\n" + " " * first_key.start_mark.column
    return (len(text), len(text), "".join(indent + entry for entry in added) + "\n") if end < 0 else (
        end, end, "".join(indent + entry for entry in added)
    )  # fmt: skip


def _last_character(text: str, end: int) -> int:
    """Where a value really ends: nested blocks are marked up to the next key."""
    return len(text[:end].rstrip()) - 1


def _number(value: float) -> str:
    """Four digits; YAML takes an exponent for a number only after a point."""
    written = f"{value:.4g}"
    mantissa, e, exponent = written.partition("e")
    return written if not e or "." in mantissa else f"{mantissa}.0e{exponent}"
