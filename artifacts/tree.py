"""Lossless conversion of nested Python values to JSON text plus arrays, and back.

null, booleans, strings, finite floats, lists and small integers are stored as JSON values. Everything else is stored as
an object with one key, which names the type. No pickle: unpacking runs no code.
"""

from __future__ import annotations

import base64
import json
import struct
from collections import OrderedDict
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from artifacts.errors import ArtifactError

ARRAY_KINDS = "biufcSU"
SCALAR_KINDS = "biufcmM"
EXACT_JSON_INTEGERS = (
    2**63
)  # larger integers are stored in hexadecimal: Python limits the length of decimal conversions


def pack(tree: Any) -> tuple[str, dict[str, np.ndarray]]:
    """Split a tree into ASCII JSON text and the arrays it refers to.

    Args:
      tree: Nested dict (str or int keys; an OrderedDict is restored as dict), list, tuple, None, bool, int, float, str,
        bytes, NumPy scalars, and arrays of numbers, booleans or strings.

    Raises:
      TypeError: The tree holds a value of another type; the message says where.
    """
    arrays: dict[str, np.ndarray] = {}
    return json.dumps(_encode(tree, arrays, "tree")), arrays


def unpack(json_text: str, arrays: Mapping[str, np.ndarray]) -> Any:
    """Restore a tree (inverse of `pack`); raise ArtifactError if `pack` did not write the text."""
    try:
        return _decode(json.loads(json_text), arrays)
    except (ValueError, LookupError, TypeError, AttributeError, SyntaxError, struct.error, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ArtifactError(f"malformed tree ({reason}): this file was not written by ifo") from error


def _encode(value: Any, arrays: dict[str, np.ndarray], where: str) -> Any:
    # NumPy scalars come first: np.float64 is a subclass of float, and np.str_ of str.
    if isinstance(value, np.generic):
        return _encode_scalar(value, where)
    kind = type(value)
    if value is None or kind in (bool, str):
        return value
    if kind is int:
        return value if abs(value) < EXACT_JSON_INTEGERS else {"int": hex(value)}
    if kind is float:
        return value if isfinite(value) else {"float": struct.pack(">d", value).hex()}
    if kind is bytes:
        return {"bytes": base64.b64encode(value).decode("ascii")}
    if kind in (list, tuple):
        items = [_encode(item, arrays, f"{where}[{i}]") for i, item in enumerate(value)]
        return items if kind is list else {"tuple": items}
    if kind in (dict, OrderedDict):
        for key in value:
            if type(key) not in (str, int):
                raise TypeError(f"{where} has the key {key!r}: expected str or int")
        return {
            "dict": [
                [_encode(key, arrays, where), _encode(item, arrays, f"{where}[{key!r}]")] for key, item in value.items()
            ]
        }
    if kind is np.ndarray and value.dtype.kind in ARRAY_KINDS:
        name = f"{len(arrays):06d}"
        arrays[name] = value
        return {"array": name}
    described = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"a {kind.__name__}"
    raise TypeError(f"{where} is {described}: expected plain values or arrays of numbers, booleans or strings")


def _encode_scalar(value: np.generic, where: str) -> Any:
    if type(value) is np.str_:
        return {"numpy str": str(value)}
    if type(value) is np.bytes_:
        return {"numpy bytes": base64.b64encode(bytes(value)).decode("ascii")}
    if value.dtype.kind not in SCALAR_KINDS:
        raise TypeError(f"{where} is a NumPy scalar of {value.dtype}: expected a number or boolean")
    return {"scalar": [value.dtype.str, value.tobytes().hex()]}


def _decode(node: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(node, list):
        return [_decode(item, arrays) for item in node]
    if not isinstance(node, dict):
        return node
    ((tag, content),) = node.items()
    if tag == "dict":
        return {_decode(key, arrays): _decode(item, arrays) for key, item in content}
    if tag == "tuple":
        return tuple(_decode(item, arrays) for item in content)
    if tag == "array":
        return arrays[content]
    if tag == "int":
        return int(content, 16)
    if tag == "float":
        return struct.unpack(">d", bytes.fromhex(content))[0]
    if tag == "bytes":
        return base64.b64decode(content, validate=True)
    if tag == "numpy str":
        return np.str_(content)
    if tag == "numpy bytes":
        return np.bytes_(base64.b64decode(content, validate=True))
    if tag == "scalar":
        dtype = np.dtype(content[0])
        if dtype.kind not in SCALAR_KINDS:
            raise ValueError(f"scalar of {dtype}")
        return np.frombuffer(bytes.fromhex(content[1]), dtype)[0]
    raise ValueError(f"unknown type {tag!r}")
