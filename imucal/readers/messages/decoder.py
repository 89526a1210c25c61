"""Messages -> numbers in columns: the fast way for messages of one shape, the walk for the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.column_store import Columns
from imucal.readers.containers import Batch, Loss, gather
from imucal.readers.files import DamagedError
from imucal.readers.messages.definitions import Field
from imucal.readers.messages.fields import Messages
from imucal.readers.messages.message_types import ImuFields
from imucal.readers.messages.template import Template, learn
from imucal.readers.messages.walker import Found, Layout, Walker

#: Encapsulation, as a big-endian number -> layout. Source: OMG DDS-XTypes 1.3, table 60; DDSI-RTPS 10.2.
_ENCAPSULATIONS = {
    0x0000: Layout(order=">", align=8),
    0x0001: Layout(order="<", align=8),
    0x0006: Layout(order=">", align=4),
    0x0007: Layout(order="<", align=4),
}
_ROS1 = Layout(order="<", align=1)
_CDR = _ENCAPSULATIONS[0x0001]


@dataclass(frozen=True, slots=True)
class Shape:
    """The fields of a message type, and which of them to take."""

    fields: tuple[Field, ...]
    imu: ImuFields


def reachable(imu: ImuFields, fields: Sequence[Field]) -> ImuFields | None:
    """Return the fields that a user asked for as the walk takes them; None where it can't reach them all.

    It can reach numbers, and elements of arrays and of sequences of numbers, that stand before any list of
    structures that hold texts. The three elements of an array of three are taken at once.
    """
    known = {entry.path: entry for entry in fields}
    for path in imu.wanted:
        owner = known.get(path.rpartition("[")[0]) if path.endswith("]") else None
        whole = known.get(path)
        inside = owner is not None and (
            (owner.kind == "sequence" and owner.count == 1)
            or (owner.kind == "array" and int(path.rpartition("[")[2].rstrip("]")) < owner.count)
        )
        if not inside and (whole is None or whole.kind != "number"):
            return None
    return imu


class BinaryDecoder:
    """Decodes the ROS 1 or CDR messages of one channel.

    Parameters
    ----------
    shapes
        Definitions to try on the first messages: the log's own, and the standard one of its type. The
        first whose size fits is taken; where none fits, the first.
    exact
        Whether messages must have exactly the size of their definition, which is then only assumed.
    """

    def __init__(self, shapes: Sequence[Shape], *, ros1: bool, exact: bool = False) -> None:
        self.ros1 = ros1
        self.notes: list[Loss] = []
        self._shapes = tuple(shapes)
        self._exact = exact
        self._settled = False
        self._use(self._shapes[0])

    def _use(self, shape: Shape) -> None:
        self.imu = shape.imu
        self.walker = Walker(shape.fields, shape.imu.wanted)
        self._whole = Walker(shape.fields, [shape.fields[-1].path]) if self._exact else None
        self._template: Template | None = None

    def settle(self, batch: Batch) -> None:
        """Choose the definition by the size of the first messages; called once, before all others.

        A damaged definition shifts every field: its messages then have another size.
        """
        if self._settled:
            return
        self._settled = True
        few = batch.checked()
        few = few.part(np.arange(min(few.n, 16)))
        if few.n and len(self._shapes) > 1 and not self._fits(self._shapes[0], few):
            for shape in self._shapes[1:]:
                if self._fits(shape, few):
                    self._use(shape)
                    text = "the definition in the log does not fit its messages; the standard one was used"
                    self.notes.append(Loss(code="definition", text=text))

    def _fits(self, shape: Shape, batch: Batch) -> bool:
        """Say whether messages have the size of a definition; CDR may be padded to four bytes."""
        if shape.fields[-1].kind == "other":
            return True
        body, layout = batch.payload(), _ROS1
        try:
            if not self.ros1:
                codes = gather(batch.buffer, body, 2).view(">u2")
                layout, body = _ENCAPSULATIONS.get(int(codes[0]), _CDR), body + 4
            end = Walker(shape.fields, [shape.fields[-1].path]).walk(batch.buffer, body, layout).end
        except DamagedError:
            return False
        spare = batch.sizes - np.int64(0 if self.ros1 else 4) - end
        return bool(np.all((spare >= 0) & (spare < (2 if self.ros1 else 4))))

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Decode records that all repeat the shape of the first one seen; False if they don't."""
        template = self._template
        if template is None or not template.fits(batch):
            try:
                template = self._template = self._learn(batch) if batch.n else None
            except DamagedError:
                return False
        return template is not None and template.decode(batch, columns, first)

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode a checked batch whose messages may all differ.

        Raises
        ------
        DamagedError
            If a message is shorter than its type, or is laid out in an unknown way.
        """
        if self.ros1:
            self._walk(batch, batch.payload(), _ROS1, columns, slice(first, first + batch.n))
        elif batch.n:
            self._by_encapsulation(batch, columns, first)

    def _learn(self, batch: Batch) -> Template | None:
        """Learn the shape of the first record; None where its messages can't be taken at once."""
        if self._whole is not None:
            return None
        body, layout, code = batch.starts[:1] + batch.header, _ROS1, b""
        if not self.ros1:
            code = bytes(gather(batch.buffer, body, 2))
            known = _ENCAPSULATIONS.get(int.from_bytes(code, "big"))
            if known is None:
                return None
            layout, body = known, body + 4
        return learn(batch, self.walker.walk(batch.buffer, body, layout), layout, code, self.imu)

    # The walk

    def _by_encapsulation(self, batch: Batch, columns: Columns, first: int) -> None:
        """Walk the messages of each encapsulation on their own."""
        if int(np.min(batch.sizes)) < 4:
            msg = "a message is too short for CDR"
            raise DamagedError(msg)
        payload = batch.payload()
        codes = gather(batch.buffer, payload, 2).view(">u2")
        kinds = codes[:1] if (codes == codes[0]).all() else np.unique(codes)
        for kind in kinds.tolist():
            layout = _ENCAPSULATIONS.get(kind)
            if layout is None:
                msg = f"encapsulation 0x{kind:04x} is not supported; expected plain CDR or XCDR2"
                raise DamagedError(msg, code="encapsulation")
            if kinds.size == 1:
                self._walk(batch, payload + 4, layout, columns, slice(first, first + batch.n))
            else:
                chosen = np.flatnonzero(codes == kind)
                self._walk(batch.part(chosen), payload[chosen] + 4, layout, columns, chosen + first)

    def _walk(
        self, batch: Batch, body: IntArray, layout: Layout, columns: Columns, to: slice | IntArray
    ) -> None:
        found = self.walker.walk(batch.buffer, body, layout)
        self._check_size(batch, body, layout, found)
        columns.log[to] = batch.log_ns
        Messages(batch.buffer, body, found.places).write(self.imu, columns, to)

    def _check_size(self, batch: Batch, body: IntArray, layout: Layout, found: Found) -> None:
        """Refuse messages that end before the last wanted field; bytes after it are not looked at."""
        skipped = 0 if self.ros1 else 4
        if bool(np.any(found.end > batch.sizes - np.int64(skipped))):
            msg = "a message is shorter than its type"
            raise DamagedError(msg)
        if self._whole is not None:
            end = self._whole.walk(batch.buffer, body, layout).end
            if bool(np.any(np.abs(end + skipped - batch.sizes) > 3)):
                msg = "messages do not have the size of the built-in definition of their type"
                raise DamagedError(msg, code="definition")
