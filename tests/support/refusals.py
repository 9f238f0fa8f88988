"""Wrong calls that have to be refused in words."""

import warnings

import pytest


def check_refused(call, error, words):
    """A call raises an error whose message has the words, and nothing is said by a warning instead."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(error) as caught:
            call()
    assert words in str(caught.value)
