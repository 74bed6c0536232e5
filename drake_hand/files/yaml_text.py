"""YAML as people write it by hand: plain data, every key once, and on which line something is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from drake_hand.errors import InputError

MOST_VALUES = 1_000_000
"""A text whose anchors unfold to more than this is refused."""


class _Loader(yaml.SafeLoader):
    """YAML 1.1 safe loader that refuses keys given twice, and lists and mappings as keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                kind = "list" if isinstance(key_node, yaml.SequenceNode) else "mapping"
                raise yaml.MarkedYAMLError(None, None, f"a key is a {kind}", key_node.start_mark)
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.MarkedYAMLError(None, None, f"key '{key}' given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def parse_yaml(text: str) -> Any:
    """The data in a YAML text.

    Raises:
        InputError: not YAML, a key given twice or no name, an anchor that contains itself; with the line.
    """
    line, found = None, ""
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _values(node, set(), {}) <= MOST_VALUES:
            return loader.construct_document(node)
        found = f"anchors that unfold to more than {MOST_VALUES} values"
    except yaml.MarkedYAMLError as e:
        line = e.problem_mark.line + 1 if e.problem_mark else None
        found = " ".join(str(e.problem or e).split())
    except Exception as e:  # constructors of numbers and dates raise errors of their own
        found = " ".join(str(e).split()) or type(e).__name__
    raise InputError("not valid YAML", found=found, expected="well-formed YAML", line=line)


def line_of(text: str, key: str) -> int | None:
    """The line, counted from 1, of a key such as ``motion[0].rotate``; of the part of it that is there, if any."""
    node, line = yaml.compose(text, yaml.SafeLoader), None
    for step in re.findall(r"[^.\[\]]+", key):
        inner = dict(_children(node)).get(step)
        if inner is None:
            break
        (line, node) = inner
    return line


def _children(node: yaml.Node | None) -> Iterator[tuple[str, tuple[int, yaml.Node]]]:
    """By key or index: line and node of what is in a node."""
    if isinstance(node, yaml.MappingNode):
        yield from ((str(k.value), (k.start_mark.line + 1, v)) for k, v in node.value)
    elif isinstance(node, yaml.SequenceNode):
        yield from ((str(i), (v.start_mark.line + 1, v)) for i, v in enumerate(node.value))


def _values(node: yaml.Node, above: set[int], known: dict[int, int]) -> int:
    """How many values a node unfolds to; `above` are the nodes around it, `known` those counted before."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in above:
        raise yaml.MarkedYAMLError(None, None, "an anchor contains itself", node.start_mark)
    if id(node) not in known:
        inner = node.value if isinstance(node, yaml.SequenceNode) else [n for pair in node.value for n in pair]
        known[id(node)] = 1 + sum(_values(n, above | {id(node)}, known) for n in inner)
    return known[id(node)]
