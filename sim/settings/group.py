"""A group of settings: frozen, and checked once when it is created."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]  # A seed; the largest is the largest integer that tables hold


class Group(BaseModel):
    """A frozen group of settings; unknown keys, infinities, NaN and true or false in place of a number are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _true_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        types = set(_list_types(cls.model_fields[str(info.field_name)].annotation))
        if types & {int, float} and not types & {bool, Any} and _holds_bool(value):
            raise PydanticCustomError("number_type", "Input should be numeric, not true or false")
        return value

    def override(self, changes: "Group") -> Self:
        """The group in which the settings of other values than None in ``changes`` replace its own."""
        return self.model_copy(update={name: value for name, value in changes if value is not None})


def _holds_bool(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(map(_holds_bool, value.values()))
    return isinstance(value, bool) or (isinstance(value, list | tuple) and any(map(_holds_bool, value)))


def _list_types(annotation: Any) -> Iterator[Any]:
    """The types that a type is composed of; those of a Literal are its values."""
    yield annotation
    for part in get_args(annotation):
        yield from _list_types(part)
