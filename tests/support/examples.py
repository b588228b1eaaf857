"""Number of examples of property tests, by the profile of hypothesis."""

from __future__ import annotations

from typing import Any

from hypothesis import settings

CI_EXAMPLES = 100
"""Of a test that states no number, in the profile ``ci``."""


def examples(count: int, **more: Any) -> settings:
    """Settings with ``count`` examples in the profile ``ci``, and more in others in proportion."""
    return settings(max_examples=count * settings().max_examples // CI_EXAMPLES, **more)
