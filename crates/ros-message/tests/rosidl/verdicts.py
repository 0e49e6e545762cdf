"""Prints what rosidl makes of each text of texts.txt, as verdicts.jsonl has it.

    PYTHONPATH=EMPY python verdicts.py texts.txt > verdicts.jsonl

The Python has rosidl_adapter, rosidl_parser and rosidl_generator_type_description 4.6.6, those of ROS 2 Jazzy from PyPI. The templates of
rosidl need empy 3: EMPY is a directory with empy 3.3.4.

A text is a .msg file of the type test_msgs/msg/Test, in JSON, on a line that begins with a quote; other lines are comments. Every type of
another name that a text uses has one field, `int32 x`.

`adapter` says whether the adapter reads the text, and `values` are its defaults. `idl` says whether the parser of IDL reads what the adapter
writes, and `built` are the defaults after that, if they differ. `hash` is RIHS01.
"""

import ast
import contextlib
import io
import json
import pathlib
import sys

from rosidl_adapter.parser import parse_message_string
from rosidl_adapter.resource import evaluate_template
from rosidl_generator_type_description import (
    calculate_type_hash,
    extract_full_type_description,
    serialize_individual_type_description,
)
from rosidl_parser.definition import AbstractNestedType, BasicType, Member, Message, NamespacedType
from rosidl_parser.parser import parse_idl_string

PACKAGE, NAME = "test_msgs", "Test"


def shown(value):
    """A value as JSON: floating numbers as texts, for readers of JSON round them."""
    if isinstance(value, float):
        return repr(value)
    return [shown(element) for element in value] if isinstance(value, (list, tuple)) else value


def adapted(specification):
    fields = {field.name: field.default_value for field in specification.fields if field.default_value is not None}
    return shown_all(fields), shown_all({constant.name: constant.value for constant in specification.constants})


def shown_all(values):
    return {name: shown(value) for name, value in values.items()}


def built(message):
    def value(member):
        value = member.get_annotation_value("default")["value"]
        # As the generators do: defaults of arrays are tuples of Python in a string.
        return ast.literal_eval(value) if isinstance(member.type, AbstractNestedType) else value

    members = [member for member in message.structure.members if member.has_annotation("default")]
    return shown_all({member.name: value(member) for member in members}), shown_all({c.name: c.value for c in message.constants})


def hash_of(message):
    name = "/".join(message.structure.namespaced_type.namespaced_name())
    types = {name: serialize_individual_type_description(message.structure.namespaced_type, message.structure.members)}
    for member in message.structure.members:
        inner = member.type.value_type if isinstance(member.type, AbstractNestedType) else member.type
        if isinstance(inner, NamespacedType):
            members = [Member(BasicType("int32"), "x")]
            types["/".join(inner.namespaced_name())] = serialize_individual_type_description(inner, members)
    return calculate_type_hash(extract_full_type_description(name, types))


def verdict(text):
    found = {"text": text, "adapter": False}
    try:
        specification = parse_message_string(PACKAGE, NAME, text)
        found["values"], found["constants"] = adapted(specification)
        found["adapter"] = True
    except Exception as error:
        return found | {"why": f"{type(error).__name__}: {error}"[:160]}
    found["idl"] = False
    try:
        data = {"pkg_name": PACKAGE, "relative_input_file": f"msg/{NAME}.msg", "msg": specification}
        # It is written as ISO 8859-1, and read as UTF-8.
        idl = evaluate_template("msg.idl.em", data).encode("iso-8859-1").decode("utf-8")
        message = parse_idl_string(idl).get_elements_of_type(Message)[0]
        values, constants = built(message)
        found["idl"] = True
        if values != found["values"]:
            found["built"] = values
        if constants != found["constants"]:
            found["built_constants"] = constants
        found["hash"] = hash_of(message)
    except (Exception, SystemExit) as error:
        found["why"] = f"{type(error).__name__}: {error}".splitlines()[0][:160]
    return found


if __name__ == "__main__":
    for line in pathlib.Path(sys.argv[1]).read_text(encoding="utf-8").split("\n"):
        if line.startswith('"'):
            with contextlib.redirect_stderr(io.StringIO()):
                found = verdict(json.loads(line))
            print(json.dumps(found))
