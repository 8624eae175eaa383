"""The base of every settings model."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict


@dataclass(frozen=True, slots=True)
class Means:
    """What a pattern asks for, in words for people: metadata of a field that has one."""

    text: str


class Settings(BaseModel):
    """Frozen, typed, and strict about names: a key that no field has is a mistake, not a comment.

    A docstring under a field becomes its description, in sample files and in config/SETTINGS.md.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)
