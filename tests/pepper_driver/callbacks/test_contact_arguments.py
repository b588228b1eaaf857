"""Typed arguments of calls that select contacts."""

from typing import get_args, get_type_hints

from pepper_driver.callbacks.filters import ContactArguments
from pepper_driver.config.contact_selector import ContactSelector


def test_the_typed_arguments_of_calls_are_the_fields_of_a_selector() -> None:
    fields = get_type_hints(ContactSelector)
    arguments = get_type_hints(ContactArguments)
    assert arguments.keys() == fields.keys() | {"phase"}
    assert set(get_args(arguments["kind"])) == set(get_args(fields["kind"]))
