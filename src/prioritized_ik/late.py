"""Fields of records that are put together when the first of them is looked at: a control loop looks at few."""

from typing import Any


class Late:
    """Such a field. The record has `late_fields()`, which returns the values of all of them by name."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, record: Any, owner: type) -> Any:
        if record is None:
            return self
        record.__dict__.update(record.late_fields())
        return record.__dict__[self._name]
