"""All events of a simulated Pepper, and all ways to receive them. Run: python examples/react_to_touch.py."""

import asyncio

from pepper_driver import (
    Contact,
    FaultError,
    FaultEvent,
    Hold,
    Pepper,
    ReflexEvent,
    SensorEvent,
    TickEvent,
)

BACKEND = "mujoco://?plant=integral"

pepper = Pepper(BACKEND, reflexes=[Hold()])


# Callbacks: each has a thread of its own, and may take its time.
@pepper.on_contact(link="LBicep", phase=None)
def contact(event: Contact) -> None:
    """Begin, updates and end of what touches the left upper arm."""
    if event.phase != "update":
        print(f"{event.time:5.2f} s  {event.phase} of {event.kind} {event.id} on {event.link}")


@pepper.on_touch(sensor="Head/Touch/Middle", pressed=None)
@pepper.on_bumper()
@pepper.on_button()
def sensor(event: SensorEvent) -> None:
    """One function for several kinds of events: it sees them in order, one at a time."""
    print(f"{event.time:5.2f} s  {event.kind} {event.name} {'on' if event.pressed else 'off'}")


@pepper.on_reflex(name="hold", phase=None)
def reflex(event: ReflexEvent) -> None:
    """Print the reflex, which has acted inside the tick already."""
    print(f"{event.time:5.2f} s  {event.phase} of reflex {event.reflex}")


@pepper.on_fault()
def fault(event: FaultEvent) -> None:
    """Print the fault; the robot stands still until a new start."""
    print(f"{event.time:5.2f} s  stopped: {event.fault.text}")


@pepper.on_tick(every=83)
def second(event: TickEvent) -> None:
    """About once a second."""
    measurement = event.tick.measurement
    print(f"{measurement.time:5.2f} s  battery {100 * measurement.battery:.0f} %")


def push_arm() -> None:
    """Only a simulated robot can push itself."""
    pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.8)


async def listen() -> None:
    """Contacts for asyncio, until the robot is closed."""
    async for event in pepper.contacts(min_intensity_deg=1.0):
        print(f"{event.time:5.2f} s  asyncio received contact {event.id}")


async def main() -> None:
    """Run the robot in a thread of its own while the event loop does other things."""
    listener = asyncio.create_task(listen())
    with pepper:
        pepper.set_posture({"LShoulderRoll": 0.4}, duration=1.5)
        await asyncio.to_thread(pepper.run, 2.5)

        head = pepper.config.sensors.touch["Head/Touch/Middle"]
        pepper.push("Head", [0, 0, -3], point=head.xyz, duration=0.3)
        push_arm()
        await asyncio.to_thread(pepper.run, 2.0)
    await listener


asyncio.run(main())

with pepper:  # again, without asyncio: wait for a contact, and let the robot run meanwhile
    pepper.run(1.0)
    push_arm()
    detected = pepper.wait_for_contact(timeout=2.0, joint="LShoulderRoll")
    print("waited for", "nothing" if detected is None else f"contact {detected.id}")
    pepper.emergency_stop()
    try:
        pepper.run(1.0)
    except FaultError as error:
        print(error)

for statistics in pepper.callback_statistics:
    print(f"{statistics.name}: {statistics.calls} calls, {statistics.dropped} events lost")
