"""Records of arrays that are passed to compiled code as one pointer.

Passing an array to a kernel takes about 0.1 us, and more in a ``NamedTuple``. ``unbox`` stores a record of arrays in
compiled memory once. Every call then passes a handle, which takes 0.3 us for any number of arrays. Kernels read the
field ``record``::

    data = unbox(Data(np.zeros(3), np.zeros((3, 3))))

    @njit(cache=True)
    def kernel(data: Unboxed[Data]) -> float:
        return data.record.vector[0]

Python and kernels may change the elements of the arrays. The arrays and the numbers of the record are fixed.

Arrays read from a handle are borrowed: kernels do not count references to them, because counting takes longer than
many kernels. A kernel must not return such an array or store it in another record.
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
    """Handle to a record in compiled memory."""

    record: T  #: The record; readable in compiled code only
    _numba_type_ = vars(structref.StructRefProxy)["_type"]  # read on every call: the slot, not a Python property


structref.define_proxy(Unboxed, _UnboxedType, ["record"])


@lower_getattr(_UnboxedType, "record")
def _read_record(context: Any, builder: Any, handle: Any, value: Any) -> Any:
    """Read the record with borrowed arrays, without taking a reference to each array."""
    record = structref._Utils(context, builder, handle).get_data_struct(value).record
    return _borrow(context, builder, handle.field_dict["record"], record)


def _borrow(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Array, or record of arrays, without owner."""
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
    """Compiled function that stores the records of a module; one function per module.

    Its cache index contains the types of the records, so reading the index imports their modules.
    """

    def keep(record: Any) -> Any:
        return Unboxed(record)

    keep.__qualname__ = f"keep_{module}"  # names the index
    return njit(cache=True)(keep)


def unbox(record: T) -> Unboxed[T]:
    """Store a record of arrays, numbers and nested records in compiled memory."""
    kept: Unboxed[T] = _keeper(type(record).__module__)(record)
    return kept
