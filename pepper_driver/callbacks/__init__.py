"""Events of a robot and their delivery: callbacks, waiting, asyncio."""
