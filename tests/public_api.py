"""Comparison of the public names with those of the last release, in ``public_api.json``.

``python -m tests.public_api`` writes the file for the next release. After release 1.0, it fails if
a name was removed without a deprecation ("Stability" in ``docs/reference/python.md``).
"""

import inspect
import json
import re
from pathlib import Path

import smarttouch
from smarttouch import lab, plugins, testing, types

RELEASED = Path(__file__).with_suffix(".json")
MODULES = smarttouch, types, plugins, testing, lab
MESSAGE = re.compile(r"since (\d+)\.(\d+), removed in (\d+)\.(\d+): use (\S.*)")
"""Format that each deprecation message must have."""


def names_of(module):
    """Return the public names of a module, without names such as ``@py_builtins`` of pytest."""
    names = getattr(module, "__all__", vars(module))
    return {each for each in names if each[0] != "_" and each.isidentifier()}


def described(name, value):
    """Yield a name and its parameters, each with its deprecation message or an empty text."""
    inner = getattr(value, "fget", None) or getattr(value, "__func__", value)
    yield name, getattr(inner, "__deprecated__", "")
    made = value.__init__ if inspect.isclass(value) else getattr(value, "__func__", value)
    if inspect.isfunction(made) and made.__module__.startswith("smarttouch"):
        for each in inspect.signature(made).parameters:
            if each[0] != "_" and each not in ("self", "cls"):
                yield f"{name}.{each}", ""


def members_of(owner):
    """Yield name and value of each member that the package defines. Annotations have value None."""
    bases = [each for each in owner.__mro__ if each.__module__.startswith("smarttouch")]
    for base in reversed(bases):
        yield from dict.fromkeys(inspect.get_annotations(base)).items()
        yield from vars(base).items()


def public_names():
    """Map public names, ``module.Name.member.parameter``, to their deprecation messages.

    If two modules export a class, the members of the class are listed only under the first one.
    """
    found, seen = {}, set()
    for module in MODULES:
        for name in names_of(module):
            value, where = getattr(module, name), f"{module.__name__}.{name}"
            found.update(described(where, value))
            if inspect.isclass(value) and id(value) not in seen:
                for member, inner in members_of(value):
                    if member[0] != "_":
                        found.update(described(f"{where}.{member}", inner))
            seen.add(id(value))
    return found


def unannounced(before, names, version):
    """Return the missing names, except those whose removal by this version was announced."""
    gone = []
    for name in sorted({*before["names"]} - {*names}):
        parts = name.split(".")
        messages = (
            before["deprecated"].get(".".join(parts[:end])) for end in range(len(parts) + 1)
        )
        message = MESSAGE.fullmatch(next(filter(None, messages), ""))
        if message is None or version < (int(message[3]), int(message[4])):
            gone.append(name)
    return gone


def read_released():
    """Return names and deprecation messages of the last release, and whether it is 1.0 or later."""
    read = json.loads(RELEASED.read_text("utf-8"))
    names = [
        f"{owner}{each}" for owner, rest in read["names"].items() for each in ["", *rest.split()]
    ]
    promised = re.fullmatch(r"[1-9]\d*[.\d]+", read["version"]) is not None  # not 1.0rc1
    return {"promised": promised, "names": names, "deprecated": read["deprecated"]}


def number_of(version):
    """Return the major and the minor number of a version."""
    return tuple(int(each) for each in version.split(".")[:2])


def main():
    """Write ``public_api.json``, unless a name was removed without an announcement."""
    names, before = public_names(), read_released()
    gone = unannounced(before, names, number_of(smarttouch.__version__))
    if gone and before["promised"]:
        raise SystemExit(f"removed without deprecation, restore: {', '.join(gone)}")
    rests: dict[str, str] = {}
    for name in sorted(names):
        module = next(
            each.__name__ for each in MODULES[::-1] if name.startswith(f"{each.__name__}.")
        )
        public = name.removeprefix(f"{module}.").partition(".")[0]
        owner = f"{module}.{public}"
        rests[owner] = f"{rests.get(owner, '')} {name.removeprefix(owner)}".strip()
    deprecated = {name: message for name, message in sorted(names.items()) if message}
    whole = {"version": smarttouch.__version__, "names": rests, "deprecated": deprecated}
    RELEASED.write_text(json.dumps(whole, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
