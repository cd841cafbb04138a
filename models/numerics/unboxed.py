"""Records of arrays that compiled code takes as one pointer.

Passing an array to a kernel takes about 0.1 us, in a ``NamedTuple`` more. ``unbox`` stores a record of arrays in
compiled memory once; every call then passes a handle, which takes 0.3 us for any number of arrays. Kernels read the
record by its field::

    data = unbox(Data(np.zeros(3), np.zeros((3, 3))))

    @njit(cache=True)
    def kernel(data: Unboxed[Data]) -> float:
        return data.record.vector[0]

The elements of the arrays may change, in Python and in kernels. The arrays and the numbers of the record are fixed.

Arrays read from a handle are borrowed: kernels do not count references to them, because counting takes longer than
many kernels. So a kernel must not return such an array, nor store it in another record.
"""

from functools import cache
from typing import Any, Generic, TypeVar

from numba.core import cgutils, types
from numba.core.imputils import lower_getattr
from numba.experimental import structref

from models.numerics.compiled import njit

T = TypeVar("T", bound=tuple[object, ...])


@structref.register
class _UnboxedType(types.StructRef):
    """Type of a handle in compiled code."""


class Unboxed(structref.StructRefProxy, Generic[T]):
    """Handle of a record in compiled memory."""

    record: T  #: The record; only compiled code reads it
    _numba_type_ = vars(structref.StructRefProxy)["_type"]  # every call reads it: the slot, not a property in Python


structref.define_proxy(Unboxed, _UnboxedType, ["record"])


@lower_getattr(_UnboxedType, "record")
def _read_record(context: Any, builder: Any, handle: Any, value: Any) -> Any:
    """The record with borrowed arrays, instead of one with as many references taken as it has arrays."""
    record = structref._Utils(context, builder, handle).get_data_struct(value).record
    return _borrow(context, builder, handle.field_dict["record"], record)


def _borrow(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """An array, or the arrays of a record, without owner."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo, array.parent = (cgutils.get_null_value(each.type) for each in (array.meminfo, array.parent))
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        kinds: Any = kind
        parts = zip(kinds, cgutils.unpack_tuple(builder, value, len(kinds)), strict=True)
        return context.make_tuple(builder, kind, [_borrow(context, builder, *part) for part in parts])
    return value


@cache
def _keeper(module: str) -> Any:
    """Compiled function that keeps the records of a module; one for each.

    The index of its cache contains the types of the records, so reading it imports their modules.
    """

    def keep(record: Any) -> Any:
        return Unboxed(record)

    keep.__qualname__ = f"keep_{module}"  # names the index
    return njit(cache=True)(keep)


def unbox(record: T) -> Unboxed[T]:
    """Keep a record, of arrays, numbers and further records, in compiled memory."""
    kept: Unboxed[T] = _keeper(type(record).__module__)(record)
    return kept
