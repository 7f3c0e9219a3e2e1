"""YAML from outside: plain data, or one sentence that names the file; never a traceback, never a hang."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from nermo_description.parameter_files import MOST_VALUES, ParameterError, parse_yaml, read_yaml, validate

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10)
)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


@given(plain)
def test_plain_data_comes_back(data: object) -> None:
    assert parse_yaml(yaml.safe_dump(data, allow_unicode=True), "here") == data


def test_aliases_and_merges_are_allowed() -> None:
    text = "base: &base {a: 1, b: 2}\nother: {<<: *base, b: 3}\nlist: [*base, *base]\n"
    assert parse_yaml(text, "here") == {
        "base": {"a": 1, "b": 2},
        "other": {"a": 1, "b": 3},
        "list": [{"a": 1, "b": 2}] * 2,
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 20_000, "nested more than 40 deep"),
        ("{a: " * 20_000, "nested more than 40 deep"),
        ("- " * 20_000, "nested more than 40 deep"),
        (BOMB, f"more than {MOST_VALUES} values, with all that aliases stand for"),
        ("a: &a [*a]", "an alias stands for what it is part of"),
        ("x" * 500_001, "is too long: allowed are 500000 bytes"),
        ("a: [1", "is not valid YAML"),
        ("a: 2026-99-99", "is not valid YAML"),
        ("a: " + "9" * 5000, "is not valid YAML"),
        ("a: !!python/object/apply:os.system [true]", "is not valid YAML"),
        ("? [a]\n: b", "is not valid YAML"),
    ],
)
def test_what_is_no_parameter_file_is_said_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError) as error:
        read_yaml(path)
    said = str(error.value)
    assert said.startswith(f"{path}: ") and words in said
    assert len(said) < 1000 and "\n" not in said


@given(st.binary(max_size=300) | st.text(alphabet="[]{}:,-&*a1 \n\"'!<>|?#%", max_size=300).map(str.encode))
def test_any_bytes_are_data_or_one_sentence(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("yaml") / "file.yaml"
    path.write_bytes(content)
    try:
        read_yaml(path)
    except ParameterError as error:
        said = str(error)
    else:
        said = f"{path}: "
    assert said.startswith(f"{path}: ")


def test_a_value_that_is_refused_is_not_repeated_at_length() -> None:
    class Model(BaseModel):
        number: float = math.pi

    with pytest.raises(ParameterError) as error:
        validate({"number": ["x"] * 100_000}, "here", Model)
    assert len(str(error.value)) < 400
