"""Files that were damaged: by their values, and by their text."""

import copy
import re
from typing import Any

import yaml
from hypothesis import strategies as st

JARGON = re.compile(
    r"Input should|String should|should (have|match|be)|Value error|validation|valid (number|integer|string)|keyword"
    r"|[Tt]uple|[Dd]ict\b|NoneType|instance of|function-|JSON|pydantic|<class|Error\b|\bNone\b|\bTrue\b|\bFalse\b"
)
"""Words of Python and its libraries, which no message about a file has."""

WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12).filter(
    lambda text: not JARGON.search(text)  # messages repeat what is in a file
)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-3, 3)
    | st.floats()
    | st.floats(-2.0, 2.0)
    | WORDS
    | st.dates()
    | st.binary(max_size=4)
    | st.sampled_from(["on", "~", "1e3", "0x1f", "Stand", "HeadYaw", "LBicep", "push", "retract"])
)
ANYTHING = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(WORDS | st.integers() | st.none() | st.booleans(), inner, max_size=4)
    ),
    max_leaves=10,
)


@st.composite
def damaged(draw: st.DrawFn, whole: Any) -> Any:
    """``whole`` with up to three values anywhere replaced, or keys renamed, removed, or entries doubled."""
    data = copy.deepcopy(whole)
    for _ in range(draw(st.integers(1, 3))):
        node = data
        while node:
            key = draw(st.sampled_from(list(node) if isinstance(node, dict) else range(len(node))))
            child = node[key]
            if isinstance(child, dict | list) and child and draw(st.integers(0, 3)):
                node = child
                continue
            action = draw(st.sampled_from(["replace", "replace", "remove", "rename", "double"]))
            if action == "replace":
                node[key] = draw(ANYTHING)
            elif action == "remove":
                del node[key]
            elif isinstance(node, list):
                node.append(copy.deepcopy(child))
            elif action == "rename":
                other = draw(WORDS | st.sampled_from(list(node)))
                node[other] = node.pop(key)
            break
    return data


@st.composite
def damaged_text(draw: st.DrawFn, text: str) -> str:
    """A text from which a piece was cut, or into which something was written."""
    at = draw(st.integers(0, len(text)))
    end = min(len(text), at + draw(st.integers(0, 30)))
    written = draw(
        WORDS | st.sampled_from(["[", "{", "- ", ": ", "&a ", "*a", "!!python/name:os", "\t"])
    )
    return text[:at] + written + text[end:]


def dump(data: Any) -> str:
    """As YAML."""
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # seven times as fast
    return str(yaml.dump(data, Dumper=dumper, allow_unicode=True, sort_keys=False))
