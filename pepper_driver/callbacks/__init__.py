"""Events of a robot and the ways to receive them: callbacks, waiting, asyncio."""
