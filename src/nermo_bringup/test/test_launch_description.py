from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_bringup.launch.description import load, load_arguments
from nermo_bringup.launch.executables import command_line
from nermo_bringup.launch.substitution import Substituter, SubstitutionError
from nermo_bringup.launch.xml import LaunchError

NODE = '<node pkg="toys" exec="toy"{}/>'


def one_node(prefix, body, **arguments):
    (node,) = load(prefix.launch_file(body), arguments).nodes
    return node


def test_arguments_have_defaults_and_can_be_given(prefix):
    file = prefix.launch_file(
        '<arg name="robot" default="nermo" description="which"/>' + NODE.format(' name="$(var robot)"')
    )
    assert load(file, {}).nodes[0].name == "nermo"
    assert load(file, {"robot": "nermo_lite"}).nodes[0].name == "nermo_lite"
    (argument,) = load_arguments(file)
    assert (argument.name, argument.default, argument.description) == ("robot", "nermo", "which")


def test_missing_argument_is_named_with_its_line(prefix):
    file = prefix.launch_file('\n<arg name="port" description="the serial line"/>')
    with pytest.raises(LaunchError, match=r"toys\.launch\.xml:3: .*'port' \(the serial line\) must be given") as caught:
        load(file, {})
    assert caught.value.status == 2


def test_unknown_argument_lists_the_known_ones(prefix):
    file = prefix.launch_file('<arg name="robot" default="nermo"/>')
    with pytest.raises(LaunchError, match="no argument 'robto'; it takes: robot") as caught:
        load(file, {"robto": "nermo"})
    assert caught.value.status == 2


def test_choices_are_held_to(prefix):
    file = prefix.launch_file('<arg name="target" default="sim"><choice value="sim"/><choice value="link"/></arg>')
    load(file, {"target": "link"})
    with pytest.raises(LaunchError, match="target:=moon is not one of: sim, link"):
        load(file, {"target": "moon"})


def test_conditions(prefix):
    body = (
        '<arg name="target" default="sim"/>'
        + NODE.format(' name="a" if="$(equals $(var target) sim)"')
        + NODE.format(' name="b" unless="$(equals $(var target) sim)"')
        + '<group if="$(not-equals $(var target) sim)">'
        + NODE.format(' name="c"')
        + "</group>"
    )
    file = prefix.launch_file(body)
    assert [node.name for node in load(file, {}).nodes] == ["a"]
    assert [node.name for node in load(file, {"target": "serial"}).nodes] == ["b", "c"]


def test_groups_keep_namespaces_and_variables_to_themselves(prefix):
    body = (
        '<let name="who" value="outer"/><group><push_ros_namespace namespace="one"/><let name="who" value="inner"/>'
        + NODE.format(' name="$(var who)" namespace="two"')
        + '</group><push_ros_namespace namespace="three"/>'
        + NODE.format(' name="$(var who)"')
        + NODE.format(' name="x" namespace="/absolute"')
    )
    assert [node.full_name for node in load(prefix.launch_file(body), {}).nodes] == [
        "/one/two/inner",
        "/three/outer",
        "/absolute/x",
    ]


def test_empty_namespace_is_the_root(prefix):
    assert one_node(prefix, '<push_ros_namespace namespace=""/>' + NODE.format(' name="x"')).full_name == "/x"


def test_include_hands_on_arguments_and_namespace(prefix):
    prefix.launch_file('<arg name="robot" default="nermo"/>' + NODE.format(' name="$(var robot)"'), "inner.launch.xml")
    body = (
        '<push_ros_namespace namespace="a"/>'
        '<include file="$(find-pkg-share toys)/launch/inner.launch.xml"><arg name="robot" value="lite"/></include>'
        '<include file="$(dirname)/inner.launch.xml"/>'
    )
    assert [node.full_name for node in load(prefix.launch_file(body), {}).nodes] == ["/a/lite", "/a/nermo"]


def test_file_that_includes_itself_ends_in_an_error(prefix):
    file = prefix.launch_file('<include file="$(dirname)/toys.launch.xml"/>')
    with pytest.raises(LaunchError, match="include each other"):
        load(file, {})


def test_parameters_have_the_types_of_yaml(prefix):
    (prefix.share / "more.yaml").write_text("/**: {ros__parameters: {}}\n")
    values = {"a": "true", "b": "3", "c": "0.5", "d": "nermo", "e": "'3'", "f": "[1.0, 2.0]", "g": ""}
    body = '<node pkg="toys" exec="toy">' + "".join(f'<param name="{k}" value="{v}"/>' for k, v in values.items())
    node = one_node(prefix, body + '<param from="$(find-pkg-share toys)/more.yaml"/></node>')
    *named, file = node.parameters
    assert dict(named) == {"a": True, "b": 3, "c": 0.5, "d": "nermo", "e": "3", "f": [1.0, 2.0], "g": ""}
    assert file == prefix.share / "more.yaml"


def test_command_line(prefix):
    executable = prefix.executable("toy", "")
    node = one_node(
        prefix,
        '<node pkg="toys" exec="toy" name="x" namespace="n" args="--loud">'
        '<param name="robot" value="nermo"/><param name="rate" value="200.0"/>'
        '<remap from="odom" to="truth/odom"/></node>',
    )
    assert command_line(node) == [
        str(executable),
        *("--loud", "--ros-args", "-r", "__node:=x", "-r", "__ns:=/n"),
        *("-p", 'robot:="nermo"', "-p", "rate:=200.0", "-r", "odom:=truth/odom"),
    ]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<rosparam/>", r":2: <rosparam> within <launch> is not supported; supported are: arg, group"),
        (NODE.format(' launch-prefix="gdb"'), r":2: <node> with attribute 'launch-prefix' is not supported"),
        ('<node pkg="toys"/>', r":2: <node> lacks the attribute 'exec'"),
        ("\n<node pkg='toys' exec='toy'><param name='a'/></node>", r":3: <param> takes name and value, or from"),
        (NODE.format(' if="perhaps"'), r":2: if: 'perhaps' is neither true nor false"),
        (NODE.format(' name="$(var who)"'), r":2: name: there is no variable 'who'"),
        (NODE.format(' name="$(eval 1 + 1)"'), r":2: name: \$\(eval ...\) is not known"),
        (NODE.format(' name="$(var who"'), r":2: name: .* lacks a closing bracket"),
        (NODE.format(' output="paper"'), r":2: output='paper' is not supported"),
        (NODE.format(' respawn_delay="-1"'), r":2: respawn_delay='-1' is not a time"),
        ('<include file="/no/such.launch.xml"/>', r":2: the file /no/such.launch.xml does not exist"),
        ('<include file="$(find-pkg-share nothing)/x.xml"/>', r":2: file: there is no package 'nothing'"),
        ("hello", r":1: text 'hello' has no meaning"),
        ("<group>", r":3: not XML: mismatched tag"),
        ('<node pkg="toys" exec="toy"><param name="a" value="[1, x]"/></node>', r":2: the list .* all of one type"),
    ],
)
def test_what_is_not_understood_is_an_error_with_file_and_line(prefix, body, message):
    file = prefix.launch_file(body)
    with pytest.raises(LaunchError, match=r"toys\.launch\.xml" + message):
        load(file, {})


@given(st.text(st.characters(codec="utf-8"), max_size=30))
def test_substitution_leaves_other_text_alone_and_never_crashes(text):
    substitute = Substituter({"x": "value"}, Path("/folder"))
    try:
        result = substitute(text)
    except SubstitutionError:
        assert "$(" in text
    else:
        assert "$(" in text or result == text


def test_substitutions_nest_and_take_quotes(monkeypatch):
    monkeypatch.setenv("NERMO_TEST_WORD", "b c")
    substitute = Substituter({"a": "b c", "name": "a"}, Path("/folder"))
    assert substitute("<$(var $(var name))>") == "<b c>"
    assert substitute("$(equals '$(var a)' \"$(env NERMO_TEST_WORD)\")") in ("true", "false")
    assert substitute("$(and $(not false) $(equals $(var a) $(env NERMO_TEST_WORD)))") == "true"
    assert substitute("$(env NERMO_TEST_NOTHING none)$(dirname)") == "none/folder"
    assert substitute("<$(command 'printf %s \"$(var a)\"')>") == "<b c>"


@pytest.mark.parametrize(
    ("line", "message"),
    [("nermo_no_such_program", "cannot be run"), ("ls /no_such_folder", "no_such_folder"), ("false", "status 1")],
)
def test_a_command_that_fails_is_an_error(line, message):
    with pytest.raises(SubstitutionError, match=message):
        Substituter({}, Path("/folder"))(f"$(command '{line}')")
