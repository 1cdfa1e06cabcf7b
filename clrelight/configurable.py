"""Frozen dataclasses whose fields are options: to a JSON object and back, with a wrong name told by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, ClassVar, Self

import numpy as np

from clrelight.errors import InputError


class Configurable:
    """What codecs and fits share; subclasses are frozen dataclasses.

    Attributes
    ----------
    id : str
        Name in a registry.
    kind : str
        What messages call such a thing.
    """

    id: ClassVar[str]
    kind: ClassVar[str]

    def to_config(self) -> dict[str, Any]:
        """Return the options as a JSON object; `from_config` takes it back."""
        return asdict(self)  # type: ignore[call-overload]

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Self:
        """Make one from its options; InputError names an option that it does not have, or that is of a wrong type."""
        known = {f.name: str(f.type) for f in fields(cls)}  # type: ignore[arg-type]
        plain: dict[str, Any] = {}
        for key, value in config.items():
            if key not in known:
                raise InputError(f"{cls.kind} {cls.id} has no option {key!r}; it has: {', '.join(known) or 'none'}")
            plain[key] = value.item() if isinstance(value, np.generic) else value  # NumPy's are not all Python's
        try:
            made = cls(**plain)
        except TypeError:
            given = ", ".join(f"{key}={value!r}" for key, value in plain.items())
            raise InputError(f"{cls.kind} {cls.id}: an option is of a wrong type, got {given}") from None
        for key, value in plain.items():
            for kind, wanted in ((int, "a whole number"), (bool, "true or false")):
                if known[key].removesuffix(" | None") == kind.__name__ and type(value) not in (kind, type(None)):
                    raise InputError(f"{cls.kind} {cls.id}: {key} must be {wanted}, got {value!r}")
        return made
