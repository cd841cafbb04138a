"""Records of arrays that compiled code takes as one pointer.

To hand an array over to a kernel costs some 0.1 us, in a ``NamedTuple`` more. Arrays that are allocated once need to be
handed over once: ``unbox`` keeps the record in compiled memory, and every later call passes a handle (0.3 us for any
number of arrays). Kernels read the record by its field::

    data = unbox(Data(np.zeros(3), np.zeros((3, 3))))

    @njit(cache=True)
    def kernel(data: Unboxed[Data]) -> float:
        return data.record.vector[0]

What an array holds may change, in Python and in kernels; which array it is, and numbers of the record, are fixed.
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from numba.core import types
from numba.experimental import structref

from models.numerics.compiled import njit

T = TypeVar("T", bound=tuple[object, ...])


@structref.register
class _UnboxedType(types.StructRef):
    """Type of a handle in compiled code."""


class Unboxed(structref.StructRefProxy, Generic[T]):
    """Handle of a record in compiled memory."""

    record: T  #: The record; only compiled code reads it


structref.define_proxy(Unboxed, _UnboxedType, ["record"])


@njit(cache=True)
def _keep(record: Any) -> Any:
    return Unboxed(record)


def unbox(record: T) -> Unboxed[T]:
    """Keep a record, of arrays, numbers and further records, in compiled memory."""
    kept: Unboxed[T] = _keep(record)
    return kept
