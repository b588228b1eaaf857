"""Ignore: contacts that no reflex shall answer."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.reflexes.reflex import Part, Reflex


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Ignore(Reflex):
    """Reflexes of lower priority do not learn of the contacts that it is for. Callbacks and log do."""

    priority: int = 100

    @property
    def takes(self) -> frozenset[Part]:
        """Contacts, from all others."""
        return frozenset({"contacts"})
