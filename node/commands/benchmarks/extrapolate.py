"""What many UEs take, by what this machine was measured to need for one frame, one UE and one row.

Pure: costs and a demand in, ceilings and needs out. A frame is estimated by one worker and gives one row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Self

from chachart.node.data.errors import SetupError
from chachart.node.runtime.capacity import SHARE

US = 1e-6


@dataclass(frozen=True, slots=True)
class Costs:
    """Measured: processor time in microseconds, and sizes in bytes.

    Attributes
    ----------
    reader, dispatcher, feeder_io
        A frame in the feeder process, in its threads: what reads, what hands out, what sends.
    worker
        A frame in a worker.
    collector, publisher, main_io
        A frame's row in the main process, in its threads.
    subscriber
        A row in somebody who subscribes to all of them.
    fuser
        A position from what four arrays say of a UE.
    state, row
        A UE in the worker's estimator, and in the table of newest rows that worker and main process have.
    csi, chart
        A frame and a row on the wire.
    tcp_rate, curve_rate
        Frames a second through one TCP connection, plain and encrypted.
    disk_rate
        Bytes a second that snapshots are written at.
    """

    reader: float
    dispatcher: float
    feeder_io: float
    worker: float
    collector: float
    publisher: float
    main_io: float
    subscriber: float
    fuser: float
    state: float
    row: float
    csi: float
    chart: float
    tcp_rate: float
    curve_rate: float
    disk_rate: float

    @property
    def feeder(self) -> float:
        """Of a frame in the feeder's Python, of which one thread runs at a time."""
        return self.reader + self.dispatcher

    @property
    def main(self) -> float:
        """Of a row in the main process's Python."""
        return self.collector + self.publisher

    @property
    def node(self) -> float:
        """Of a frame in a whole node."""
        return self.feeder + self.feeder_io + self.worker + self.main + self.main_io

    @property
    def ue(self) -> float:
        """Bytes of a UE in a node."""
        return self.state + 2 * self.row


@dataclass(frozen=True, slots=True)
class Demand:
    """What is asked for, and of what machines; what is not told is the default.

    Attributes
    ----------
    ues
        How many there are.
    updates
        Positions that each of them gets a second.
    arrays
        How many hear each of them; each makes a frame of every update.
    cores, memory_gib, gbit
        Of one machine; its network in Gbit/s, which nothing here measures.
    load
        How busy a core or a network may be.
    every_s
        How often snapshots are written.
    """

    ues: float = 1e6
    updates: float = 1.0
    arrays: float = 1.0
    cores: float = 1.0
    memory_gib: float = 1.0
    gbit: float = 10.0
    load: float = 0.7
    every_s: float = 10.0

    @classmethod
    def parse(cls, text: str, default: Self) -> Self:
        """`ues=1e8,updates=0.1` and so on.

        Raises
        ------
        SetupError
            If a name or a value is none.
        """
        names, told = [field.name for field in fields(cls)], {}
        for item in filter(None, text.split(",")):
            name, _, value = item.partition("=")
            try:
                told[name] = float(value)
            except ValueError:
                raise SetupError(f"--simulate {item}: it takes NAME=NUMBER, such as ues=1e8") from None
            if name not in names:
                raise SetupError(f"--simulate {item}: there is no {name}; there are {', '.join(names)}")
            if not 0 < told[name] < math.inf or (name == "load" and told[name] > 1):
                raise SetupError(
                    f"--simulate {item}: {name} must be above 0{' and at most 1' * (name == 'load')}"
                )
        return replace(default, **told)

    @property
    def frames(self) -> float:
        """A second, from all UEs at all arrays."""
        return self.ues * self.updates * self.arrays

    @property
    def memory(self) -> float:
        """Bytes of a machine that states and rows may have."""
        return SHARE * self.memory_gib * 2**30

    @property
    def network(self) -> float:
        """Bytes a second that a machine may take in."""
        return self.load * self.gbit * 1e9 / 8


@dataclass(frozen=True, slots=True)
class Ceiling:
    """How far one node on one machine goes by one measure, and what goes beyond.

    Attributes
    ----------
    what, help
        In words.
    frames
        A second.
    """

    what: str
    frames: float
    help: str


def ceilings(costs: Costs, demand: Demand) -> list[Ceiling]:
    """Where one node on one machine ends, what breaks first at the head."""
    busy = demand.load / US
    per_ue = demand.updates  # an array's node sees a frame of a UE so often
    snapshots = costs.disk_rate * demand.every_s / costs.state
    found = [
        Ceiling(
            "feeder process (reader and dispatcher)", busy / costs.feeder, "a node for each array, or several"
        ),
        Ceiling(
            "main process (collector and publisher)", busy / costs.main, "a node for each array, or several"
        ),
        Ceiling("one worker", busy / costs.worker, "more workers"),
        Ceiling(f"the {demand.cores:g} cores", demand.cores * busy / costs.node, "another machine"),
        Ceiling("memory", demand.memory / costs.ue * per_ue, "another machine, or a smaller method"),
        Ceiling("the network that brings frames", demand.network / costs.csi, "the node where its array is"),
        Ceiling(
            "a producer's connection, with keys", demand.load * costs.curve_rate, "a producer for each array"
        ),
        Ceiling("one subscriber to every row", busy / costs.subscriber, "subscribers of a part each"),
        Ceiling("disk for snapshots", snapshots * per_ue, "snapshots less often"),
    ]
    return sorted(found, key=lambda ceiling: ceiling.frames)


@dataclass(frozen=True, slots=True)
class Needs:
    """What a demand takes.

    Attributes
    ----------
    nodes, workers
        Processes: feeders, each with its main process, and workers.
    cores
        By what they do, busy to the full.
    machines
        By what they are bought for: cores, memory and network.
    subscribers
        Processes, and fusing ones, that all rows need.
    csi_gbit, chart_gbit
        Gbit/s of frames in, and of rows to each who wants all.
    memory, snapshot
        Bytes of all nodes, and of one round of snapshots.
    """

    nodes: int
    workers: int
    cores: dict[str, float]
    machines: dict[str, int]
    subscribers: int
    fusers: int
    csi_gbit: float
    chart_gbit: float
    memory: float
    snapshot: float

    @property
    def first(self) -> str:
        """What the machines are bought for."""
        return max(self.machines, key=lambda what: self.machines[what])

    @property
    def dearest(self) -> str:
        """What most of the cores do."""
        return max(self.cores, key=lambda what: self.cores[what])


def needs(costs: Costs, demand: Demand) -> Needs:
    """What a demand takes, on machines like those it names."""
    frames, busy = demand.frames, demand.load / US
    fused = demand.ues * demand.updates if demand.arrays > 1 else 0.0
    memory = demand.ues * demand.arrays * costs.ue
    cores = {
        "feeders": frames * (costs.feeder + costs.feeder_io) * US,
        "workers": frames * costs.worker * US,
        "main processes": frames * (costs.main + costs.main_io) * US,
        "fusing": (fused * costs.fuser + (frames * costs.subscriber if fused else 0.0)) * US,
    }
    incoming = frames * (costs.csi + (costs.chart if fused else 0.0))
    return Needs(
        nodes=math.ceil(frames * max(costs.feeder, costs.main) / busy),
        workers=math.ceil(frames * costs.worker / busy),
        cores=cores,
        machines={
            "cores": math.ceil(sum(cores.values()) / demand.load / demand.cores),
            "memory": math.ceil(memory / demand.memory),
            "network": math.ceil(incoming / demand.network),
        },
        subscribers=math.ceil(frames * costs.subscriber / busy),
        fusers=math.ceil(fused * costs.fuser / busy),
        csi_gbit=frames * costs.csi * 8e-9,
        chart_gbit=frames * costs.chart * 8e-9,
        memory=memory,
        snapshot=demand.ues * demand.arrays * costs.state,
    )
