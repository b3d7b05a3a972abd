"""The addition of derivatives to sums in memory, as a function in LLVM's language.

Dr.Jit's additions look for equal addresses in each packet: a horizontal sum and an atomic addition for each address,
and that for each channel of a texel. This function adds an entry, all channels at once, by one vector instruction per
lane. The sums exist several times, and whoever adds to a copy keeps the others off it meanwhile: threads rarely meet,
so that one lock for a packet costs far less than atomic additions.

Each copy begins with a header, whose first word says whether the copy is taken; the sums follow.
"""

from __future__ import annotations

from djpt.jit.llvm.ir import F32, I1, I32, I64, PTR, Function, Module, Type, Value, vector

__all__ = ["ADD_ENTRIES", "AT_ONCE", "HEADER", "LARGEST", "entry_function"]

ADD_ENTRIES = "add_entries"
"""The function's name."""

AT_ONCE = 2
"""The entries of a lane that one call adds."""

HEADER = 16
"""Words before the sums of a copy: a cache line."""

LARGEST = 4
"""The numbers of the largest entry."""

NUMBERS, COPIES, INDEX, STRIDE = ((0, 1, 2, 3), (4, 5, 6, 7)), 8, (9, 10), 11
"""The arrays of a packet: the numbers of both entries, the count of copies, the indices of both entries, and the words
of a copy."""

ODD, HIGH = 0x9E3779B1, 16
"""Factor and shift that scatter the addresses of stacks."""


def entry_function(size: int, width: int) -> str:
    """The function for entries of `size` numbers, a power of two, and packets of `width` lanes."""
    module = Module()
    parameters = [("valid", PTR), ("memory", PTR), ("context", PTR), ("samples", PTR)]
    with module.function(ADD_ENTRIES, parameters) as f:
        valid, memory, _, samples = f.parameters
        active = (f.load(vector(I32, width), valid, 4) != 0).bits_as(Type("i", width)).to(I64)
        with f.when(active != 0):
            copy = taken_copy(f, memory, samples, width)
            left = f.variable(I64, active)
            with f.loop() as lanes:
                lanes.stop_if(left.value == 0)
                lane = f.intrinsic("cttz", [left.value, f.constant(I1, 1)], I64)
                left.value = left.value & (left.value - 1)
                for numbers, index in zip(NUMBERS, INDEX, strict=True):
                    entry = f.constant(vector(F32, size), 0.0)
                    for c, number in enumerate(numbers[:size]):
                        channel = f.load(F32, samples.at((lane + number * width) * 4))
                        entry = f.emit(f"insertelement {entry}, {channel}, i32 {c}", entry.type)
                    first = f.load(I32, samples.at((lane + index * width) * 4)).to(I64) * size
                    place = copy.at((first + HEADER) * 4)
                    f.store(f.load(entry.type, place) + entry, place)
            f.publish(f.constant(I32, 0), copy)
    return module.text()


def taken_copy(f: Function, memory: Value, samples: Value, width: int) -> Value:
    """The first copy that no other thread has, from one on that depends on the thread; it is taken."""
    count = f.load(F32, samples.at(COPIES * width * 4)).to(I64)
    stride = f.load(I32, samples.at(STRIDE * width * 4)).to(I64) * 4
    # Packets are on the stacks of threads.
    stack = f.emit(f"ptrtoint {samples} to i64", I64) >> 16
    number = f.variable(I64, ((stack * ODD) >> HIGH) % count)
    with f.loop() as search:
        before = f.exchange(f.constant(I32, 1), memory.at(number.value * stride))
        search.stop_if(before == 0)
        number.value = (number.value + 1) % count
    return memory.at(number.value * stride)
