"""Texts as STATUSTEXTs: what is said is what arrives, and links' own reasons fit one message."""

import math
import random

import pytest
from links_cockpit import TO, Notebook, Talk, texts

from testbed.links.replies import CHUNKS, LETTERS, Severity, Texts


def chunks(text):
    """The parts of a text as they are sent; nulls after the letters are left out."""
    return [reply.fields["text"] for reply in Texts().say(Severity.INFO, text)]


def test_a_text_that_fits_is_one_message_without_a_number():
    (reply,) = Texts().say(Severity.INFO, "x" * LETTERS)
    assert "id" not in reply.fields


def test_parts_joined_are_the_text_and_only_the_last_is_not_full():
    draw = random.Random(3)
    for _ in range(200):
        text = " ".join("w" * draw.randint(1, 24) for _ in range(draw.randint(6, 16)))
        parts = chunks(text)
        assert b"".join(parts).decode() == text
        if len(text) > LETTERS:
            # a null, which fills up the last, is what ends a text
            assert [len(part) for part in parts[:-1]] == [LETTERS] * (len(parts) - 1)
            assert len(parts[-1]) < LETTERS


@pytest.mark.parametrize("text", ["z" * 5000, "word " * 1000])
def test_what_is_too_long_ends_all_the_same(text):
    parts = chunks(text)
    assert len(parts) == CHUNKS
    assert len(parts[-1]) < LETTERS


ATTITUDE = {**TO, "time_boot_ms": 0, "type_mask": 7, "q": (1.0, 0.0, 0.0, 0.0), "thrust": 0.5}
ATTITUDE |= {f"body_{axis}_rate": 0.0 for axis in ("roll", "pitch", "yaw")}


def change(talk, name, value):
    return talk.ask("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)


@pytest.mark.parametrize(
    "ask",
    [
        *(
            lambda talk, numbers=numbers: talk.order(*numbers)
            for numbers in [
                (400, 2.0),
                (176, 0.0),
                (176, 1.0, 2.0),
                (176, 1.0, 11.0),
                (178, 1.0, 20.0),
                (300, 9.0),
                (224, math.nan),
                (246, 1.0),
                (20,),
                (21,),
                (22,),
            ]
        ),
        *(
            lambda talk, changes=changes: talk.ask("SET_ATTITUDE_TARGET", **ATTITUDE | changes)
            for changes in [
                {"type_mask": 32},
                {"type_mask": 128},
                {"thrust": math.nan},
                {"q": (2.0, 0.0, 0.0, 0.0)},
            ]
        ),
        *(
            lambda talk, pair=pair: change(talk, *pair)
            for pair in [
                ("NO_SUCH", 1.0),
                ("RC1_TRIM", 5.0),
                ("RC1_TRIM", 2100.0),
                ("RC1_TRIM", math.nan),
                ("SYSID_THISMAV", 9.0),
                ("SERVO1_FUNCTION", 9.0),
            ]
        ),
    ],
)
def test_a_reason_of_the_links_fits_one_message(ask):
    (text,) = texts(ask(Talk(Notebook())))
    assert 0 < len(text) <= LETTERS
