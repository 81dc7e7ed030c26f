"""A process that writes results as fast as it can and says each number once it is durable, until killed."""

import asyncio
import sys
from itertools import count
from pathlib import Path

from support.outcomes import add, lose_open, measured, trigger

from service.store import open_store


async def write(state_dir: Path) -> None:
    with open_store(state_dir) as store:
        session = await store.begin_session({})
        await lose_open(store, "shutdown", "the process was killed")
        for n in count():
            mesh = state_dir / "mesh.ply"
            mesh.write_bytes(b"mesh %d" % n)
            await store.record_triggers(session, {f"open {n}": trigger(0)})
            seq = await add(store, session, n % 1000, measured(n=n), {"mesh.ply": mesh})
            sys.stdout.write(f"{seq} {n}\n")
            sys.stdout.flush()
            if n % 5:
                await store.finish(session, f"open {n}", measured())


if __name__ == "__main__":
    asyncio.run(write(Path(sys.argv[1])))
