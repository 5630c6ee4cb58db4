"""Sentences are text wherever text is wanted, and remember what they say."""

from __future__ import annotations

import copy
import json
import pickle

from imucalib_cli.estimate.sentence import Says, Sentence, says_any, without
from imucalib_cli.findings import Severity, texts, warnings


def test_a_sentence_is_its_text_and_keeps_what_it_says() -> None:
    poor = Sentence("windows do not fit", Says.POOR)
    assert poor == "windows do not fit"
    assert json.dumps(poor) == '"windows do not fit"'
    for other in (copy.deepcopy(poor), pickle.loads(pickle.dumps(poor))):  # noqa: S301 - our own
        assert other == poor
        assert says_any(other, {Says.POOR})
    assert type(str(poor)) is str


def test_only_sentences_that_say_it_are_left_out() -> None:
    poor, sensor = Sentence("a", Says.POOR), Sentence("b", Says.SENSOR)
    plain = "a"  # the same words, and nothing known of them
    told = texts(Severity.WARNING, (poor, sensor, plain))
    assert warnings(without(told, {Says.POOR})) == ("b", "a")
    assert warnings(without(told, ())) == ("a", "b", "a")
    assert not says_any(plain, Says)
