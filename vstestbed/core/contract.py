"""Contract: what each member of a `OneOf` must have, checked once, when the member is registered.

A plugin that lacks a method would otherwise run until the loop first calls that method, and end with a traceback there.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from vstestbed.core.errors import ParameterError, nearest


@dataclass(frozen=True)
class Contract:
    """What a class must have to be a member of a room.

    Attributes:
        protocol: the class (a `typing.Protocol`) whose public methods and attributes every member must have.
        base: a class with defaults for most of them, recommended by the error messages; None where the room has none.
        words: the valid items of attributes that are tuples of words, by the attribute's name.
    """

    protocol: type
    base: type | None = None
    words: Mapping[str, Collection[str]] = field(default_factory=dict)

    def check(self, member: type) -> None:
        """Refuse a class that breaks the contract.

        Args:
            member: a dataclass; its fields count as attributes.

        Raises:
            ParameterError: it names the class, what is missing or wrong, and what would be valid.
        """
        required = _public_members(self.protocol)
        missing = [name for name in required if not self._has(member, name)]
        if missing:
            names = ", ".join(_shown(name, required[name]) for name in missing)
            raise ParameterError(member.__name__, f"lacks {names}; {self._remedy(member)}")
        for name, method in required.items():
            _check_shape(member, name, method)
        for name, valid in self.words.items():
            _check_words(member, name, valid)

    def _has(self, member: type, name: str) -> bool:
        """Whether a class has a member of its own: a stub inherited from the protocol does not count."""
        own = inspect.getattr_static(member, name, None)
        if own is None:
            return hasattr(member, name) or name in getattr(member, "__dataclass_fields__", {})
        return own is not vars(self.protocol).get(name)

    def _remedy(self, member: type) -> str:
        if self.base is None or issubclass(member, self.base):
            return f"add what is missing (see {self.protocol.__module__}.{self.protocol.__name__})"
        rest = [name for name in _public_members(self.protocol) if not hasattr(self.base, name)]
        return f"derive it from {self.base.__module__}.{self.base.__name__}, which has defaults for all but {' and '.join(rest)}"


def _public_members(protocol: type) -> dict[str, Callable[..., Any] | None]:
    """The public members of a protocol in the order of their definition: a method's function, None for an attribute."""
    found: dict[str, Callable[..., Any] | None] = {}
    for cls in reversed(protocol.__mro__):
        found |= dict.fromkeys(name for name in inspect.get_annotations(cls) if not name.startswith("_"))
        found |= {name: value if inspect.isfunction(value) else None for name, value in vars(cls).items() if not name.startswith("_")}
    return found


def _shown(name: str, method: Callable[..., Any] | None) -> str:
    """A member as messages show it: `depth`, or `step(memory, observation, goal, basis)`."""
    return name if method is None else f"{name}({', '.join(list(inspect.signature(method).parameters)[1:])})"


def _check_shape(member: type, name: str, method: Callable[..., Any] | None) -> None:
    """Refuse a method where an attribute belongs, an attribute where a method belongs, and a wrong number of parameters."""
    own, where = inspect.getattr_static(member, name, None), f"{member.__name__}.{name}"
    if method is None:
        if inspect.isfunction(own):
            raise ParameterError(where, "must be an attribute, and is a method; write @property above it")
        return
    if not callable(getattr(member, name, None)):
        raise ParameterError(where, f"must be a method {_shown(name, method)}")
    # Read off the class, a plain function still has its `self`; a static or class method does not.
    arguments = list(inspect.signature(method).parameters)[0 if inspect.isfunction(own) else 1 :]
    signature = inspect.signature(getattr(member, name))
    try:
        signature.bind(*arguments)
    except TypeError:
        raise ParameterError(where, f"must take the arguments of {_shown(name, method)}; it has the signature {signature}") from None


def _check_words(member: type, name: str, valid: Collection[str]) -> None:
    """Refuse an unknown word in a tuple of words.

    A property is read from an object made of the defaults alone; of a class that has none such, its words stay unchecked.
    """
    words = getattr(member, name, ())
    if isinstance(words, property):
        try:
            words = getattr(member(), name)
        except (TypeError, ParameterError):  # a field without a default, or defaults that need another value beside them
            return
    if not isinstance(words, tuple):
        raise ParameterError(f"{member.__name__}.{name}", "must be a tuple of words, such as ('xy', 'depth')", words)
    for word in words:
        if word not in valid:
            raise ParameterError(f"{member.__name__}.{name}", f"has no valid word {word!r}; {nearest(str(word), valid)}")
