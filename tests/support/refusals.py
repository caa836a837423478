"""What a refusal of bad input has to be."""

import functools

import pytest

from dc2g_jax._src.runtime.errors import InputError


def refusal_of(kind: type[Exception], call, *mentions: object) -> str:
    """The message of the refusal: one line that mentions everything it should."""
    with pytest.raises(kind) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for mention in mentions:
        assert str(mention) in message, message
    return message


refusal = functools.partial(refusal_of, InputError)
