"""Fuzzes the structure language and the reception of packets with atheris, guided by coverage.

pip install atheris
SERO_MJ_ATHERIS=1000000 pytest tests/test_hostile_packets.py -k atheris
"""

from __future__ import annotations

import sys
from collections import Counter

import atheris

with atheris.instrument_imports(include=["sero_mj.data.receive"]):
    from sero_mj.base.errors import StructureError
    from sero_mj.data.receive.intake import Intake
    from sero_mj.data.receive.structure import Structure

from packet_oracle import TEXT, cause
from test_hostile_packets import as_rows, check

FIXED = Structure(TEXT)


def attack(data: bytes) -> None:
    """Tests one input: a structure and packets for it, or packets for the fixed structure."""
    provider = atheris.FuzzedDataProvider(data)
    if provider.ConsumeBool():
        packets = [provider.ConsumeBytes(216) for _ in range(3)]
        check(Intake(FIXED), packets, Counter())
        return
    text = provider.ConsumeUnicodeNoSurrogates(30)
    try:
        layout = Structure(text, alignment=provider.PickValueInList([1, 2, 4, 8]))
    except StructureError as error:
        assert 0 <= error.position <= len(text)
        return
    if layout.size > 400:
        return
    packets = [provider.ConsumeBytes(layout.size) for _ in range(2)]
    intake = Intake(layout)
    rows, _ = intake.take(*as_rows(packets))
    intake.count()
    assert intake.counters.received == len(rows) + intake.counters.malformed
    for array in intake.decode(rows).values():
        assert array.shape[0] == len(rows)


if __name__ == "__main__":
    assert cause(b"") == "wrong_size"
    atheris.Setup(sys.argv, attack)
    atheris.Fuzz()
