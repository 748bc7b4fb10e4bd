"""Substitutions: what they stand for, what is left alone, and what is refused where."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import parse_config
from play_launch.config.model import ParameterType
from play_launch.config.problems import ConfigError
from play_launch.config.substitutions import (
    DEEPEST_DEFAULT,
    Inputs,
    Lookup,
    SubstitutionError,
    may_hold_substitutions,
    parse_arguments,
    substitute,
)

if TYPE_CHECKING:
    from play_launch.config.model import ParameterValue, ReplayConfig

VARIABLES = {"HOME": "/h", "EMPTY": "", "TRICK": "${env:HOME}"}
ARGUMENTS = {"rate": "10.0", "side": "left", "empty": ""}


def share(package: str) -> str:
    if package == "nowhere":
        raise SubstitutionError("package nowhere is not installed")
    return f"/opt/share/{package}"


LOOKUP = Lookup(VARIABLES.get, ARGUMENTS.get, share)


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("", ""),
        ("${env:HOME}", "/h"),
        ("a ${env:HOME} b ${arg:side}", "a /h b left"),
        ("${env:NONE:-x}", "x"),
        ("${env:EMPTY:-x}", "x"),
        ("${env:EMPTY}", ""),
        ("${arg:empty:-x}", "x"),
        ("${arg:rate:-1.0}", "10.0"),
        ("${arg:none:-}", ""),
        ("${arg:none:-a:b-c}", "a:b-c"),
        ("${arg:none:-[{severity}] {name}}!", "[{severity}] {name}!"),
        ("${arg:none:-{${arg:side}{}}}}", "{left{}}}"),
        ("${arg:none:-${env:NONE:-deep}}!", "deep!"),
        ("${arg:side:-${env:NONE}}", "left"),
        ("${arg:none:-$(find-pkg-share demo)/x}", "/opt/share/demo/x"),
        ("${arg:side:-$(find-pkg-share nowhere)}", "left"),
        ("$(find-pkg-share demo)/a.yaml", "/opt/share/demo/a.yaml"),
        ("$(find-pkg-share  demo )", "/opt/share/demo"),
        # A value that was put in is not looked at again.
        ("${env:TRICK}", "${env:HOME}"),
        ("$${env:HOME}", "${env:HOME}"),
        ("$$(find-pkg-share demo)", "$(find-pkg-share demo)"),
        ("$$${env:HOME}", "$${env:HOME}"),
        # For a shell.
        ("$(pkg-config --libs x) $(find_all x)", "$(pkg-config --libs x) $(find_all x)"),
        ("${HOME} $(date) $$ $1 ${X:-y} ${X:0:3} $", "${HOME} $(date) $$ $1 ${X:-y} ${X:0:3} $"),
        ("$(seq 3) $(command -v sh) ${#X}", "$(seq 3) $(command -v sh) ${#X}"),
    ],
)
def test_what_it_stands_for(text: str, result: str) -> None:
    assert substitute(text, LOOKUP) == result
    assert result == text or may_hold_substitutions(text)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("${env:NONE}", "NONE is not set"),
        ("${arg:none}", "append none:=value"),
        ("${arg:none:-${env:NONE}}", "NONE is not set"),
        ("${evn:HOME}", "is no substitution"),
        ("${env:HOME", "after the name"),
        ("${env:HOME-x}", "after the name"),
        ("${arg:none:-x", "not closed"),
        ("$(var side)", "write ${arg:NAME} here"),
        ("$(find-pkg-prefix demo)", "find-pkg-share"),
        ("$(find-pkg-shar demo)", "write $(find-pkg-share package)"),
        ("$(find_pkg_share demo)", "write $(find-pkg-share package)"),
        ("$(find-pkg-share)", "expected $(find-pkg-share package)"),
        ("$(find-pkg-share nowhere)", "package nowhere is not installed"),
        ("$(find-pkg-share de/mo)", "expected"),
        ("${arg:a:-" * (DEEPEST_DEFAULT + 1) + "}" * (DEEPEST_DEFAULT + 1), "deeper"),
    ],
)
def test_what_is_refused(text: str, why: str) -> None:
    with pytest.raises(SubstitutionError) as caught:
        substitute(text, LOOKUP)
    assert why in str(caught.value)


PIECES = st.sampled_from(
    [
        "$",
        "${",
        "$(",
        "}",
        ")",
        "env:",
        "arg:",
        ":-",
        "HOME",
        "side",
        "none",
        "find-pkg-share ",
        "a",
    ]
)


@given(st.lists(PIECES, max_size=12).map("".join) | st.text(max_size=30))
def test_any_text_has_a_result_or_a_reason(text: str) -> None:
    with contextlib.suppress(SubstitutionError):
        assert substitute(text, LOOKUP) == text or may_hold_substitutions(text)


@given(st.text(max_size=20), st.text(max_size=20), st.text(max_size=20))
def test_a_value_stays_as_it_is(before: str, value: str, after: str) -> None:
    around = [each.replace("$", "") for each in (before, after)]
    lookup = Lookup({"X": value}.get, ARGUMENTS.get, share)
    assert substitute(f"{around[0]}${{env:X}}{around[1]}", lookup) == value.join(around)


def escaped(text: str) -> str:
    return text.replace("${", "$${").replace("$(", "$$(")


@given(st.lists(PIECES, max_size=12).map("".join))
def test_an_escaped_text_is_the_text(text: str) -> None:
    assert substitute(escaped(text), LOOKUP) == text


def load(text: str, arguments: tuple[str, ...] = (), **environ: str) -> ReplayConfig:
    inputs = Inputs(arguments=parse_arguments(arguments), environ=environ)
    return parse_config(text.encode(), Path("a/demo.yaml"), inputs=inputs)


def problems(text: str, arguments: tuple[str, ...] = (), **environ: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(text, arguments, **environ)
    return [str(problem) for problem in caught.value.problems]


NODE = "version: 1\nnodes:\n- command: [x]\n"


def parameter(written: str, *arguments: str) -> ParameterValue:
    config = load(f"{NODE}  parameters:\n    it: {written}\n", arguments)
    return config.nodes[0].parameters[0].value


@pytest.mark.parametrize(
    ("written", "given", "kind", "value"),
    [
        ("${arg:v}", "5", ParameterType.INTEGER, 5),
        ("${arg:v}", "5.0", ParameterType.DOUBLE, 5.0),
        ("${arg:v}", "true", ParameterType.BOOL, True),
        ("${arg:v}", "left", ParameterType.STRING, "left"),
        ("${arg:v}", "", ParameterType.STRING, ""),
        ("${arg:v}", "null", ParameterType.STRING, "null"),
        ("1${arg:v}", "5", ParameterType.INTEGER, 15),
        ("x${arg:v}", "5", ParameterType.STRING, "x5"),
        ('"${arg:v}"', "5", ParameterType.STRING, "5"),
        ("'${arg:v}'", "true", ParameterType.STRING, "true"),
        ('!!float "${arg:v}"', "5", ParameterType.DOUBLE, 5.0),
        ('[!!int "${arg:v}", 1]', "5", ParameterType.INTEGER_ARRAY, (5, 1)),
        (
            "[a, '${arg:v}']",
            "5",
            ParameterType.STRING_ARRAY,
            ("a", "5"),
        ),
        ("${arg:v}", ": # [", ParameterType.STRING, ": # ["),
    ],
)
def test_types(written: str, given: str, kind: ParameterType, value: object) -> None:
    found = parameter(written, f"v:={given}")
    assert (found.type, found.value) == (kind, value)


def test_where_a_string_is_expected_the_result_is_one() -> None:
    text = (
        "version: 1\nduration: ${arg:n} s\nenvironment:\n  ROS_DOMAIN_ID: ${arg:n}\n"
        "composable_node_loading:\n  container_type: ${arg:kind}\n  thread_num: ${arg:n}\n"
        "containers:\n- name: c${arg:n}\nnodes:\n- command:\n  - run\n  - ${arg:n}\n"
        "  - ${env:TRUTH}\n"
    )
    config = load(text, ("n:=7", "kind:=mt"), TRUTH="true")
    assert config.nodes[0].command == ("run", "7", "true")
    assert config.environment == {"ROS_DOMAIN_ID": "7"}
    assert (config.duration, config.containers[0].thread_num) == (7.0, 7)
    assert config.containers[0].full_name == "/c7"
    assert config.taken.arguments == {"n": "7", "kind": "mt"}
    assert config.taken.variables == {"TRUTH": "true"}


def test_quotes_make_strings_and_the_message_says_so() -> None:
    text = "version: 1\ncontainers:\n- {name: c, container_type: mt, thread_num: '${arg:n}'}\n"
    (problem,) = problems(text, ("n:=4",))
    assert problem == (
        'a/demo.yaml:3:45: containers[0].thread_num: expected an integer, given the string "4"; '
        "write the substitution without quotes"
    )


@pytest.mark.parametrize(
    ("line", "place", "why"),
    [
        (
            "  log_level: ${arg:level}",
            "4:14: nodes[0].log_level",
            "the argument level is not given",
        ),
        ("  parameters:\n    a:\n      b: ${env:NONE}", "6:10: nodes[0].parameters.a.b", "not set"),
        ("  environment:\n    ${env:NONE}: a", "5:5: nodes[0].environment", "a key takes no"),
        (
            "  emulate_tty: ${arg:x:-perhaps}",
            "4:16: nodes[0].emulate_tty",
            "expected true or false",
        ),
        ("  name: ${arg:x:-a b}", "4:9: nodes[0].name", "holds"),
    ],
)
def test_mistakes_have_their_place(line: str, place: str, why: str) -> None:
    (problem,) = problems(f"{NODE}{line}\n")
    assert problem.startswith(f"a/demo.yaml:{place}: ")
    assert why in problem


def test_arguments_that_nothing_reads_are_refused() -> None:
    (problem,) = problems(f"{NODE}  log_level: ${{arg:level:-warn}}\n", ("levl:=info",))
    assert problem == (
        "a/demo.yaml:1:1: (arguments): nothing reads the argument levl; known arguments: level"
    )
    (problem,) = problems(NODE, ("x:=1",))
    assert problem.endswith("the configuration reads no arguments")


def test_an_argument_that_only_a_default_reads_is_read() -> None:
    text = f"{NODE}  log_level: ${{arg:a:-${{arg:b:-warn}}}}\n"
    assert load(text, ("b:=error",)).nodes[0].log_level == "error"
    assert load(text, ("a:=info", "b:=error")).nodes[0].log_level == "info"


@pytest.mark.parametrize("text", ["x", "x=1", ":=1"])
def test_what_is_no_argument(text: str) -> None:
    with pytest.raises(ValueError, match=r"write name:=value"):
        parse_arguments([text])


def test_arguments() -> None:
    assert parse_arguments(["a:=1", "b:=x:=y", "c:="]) == {"a": "1", "b": "x:=y", "c": ""}
    with pytest.raises(ValueError, match="given twice"):
        parse_arguments(["a:=1", "a:=2"])


def test_a_surrogate_from_the_environment_is_refused() -> None:
    (problem,) = problems(f"{NODE}  name: ${{env:BROKEN}}\n", BROKEN="\udcff")
    assert "half of a surrogate pair" in problem


def test_packages_are_found_in_the_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    folder = tmp_path / "share/demo"
    folder.mkdir()
    (folder / "p.yaml").write_text("/**: {ros__parameters: {rate: 1.0}}\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    config = load(f"{NODE}  parameters: ['$(find-pkg-share demo)/p.yaml']\n")
    assert config.nodes[0].parameters[0].name == "rate"
    assert config.taken.packages == {"demo": str(folder)}
    (problem,) = problems(f"{NODE}  name: $(find-pkg-share other)\n")
    assert "package other is not installed" in problem
