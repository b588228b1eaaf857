"""A simulated Pepper raises its arm, is pushed, stops, and prints the contact. Run: python examples/feel_a_push.py."""

from pepper_driver import Contact, Hold, Pepper

pepper = Pepper("mujoco://?plant=integral", reflexes=[Hold()])  # Hold: stand still while touched


@pepper.on_contact()
def touched(contact: Contact) -> None:
    """Print a contact that begins, on a thread of its own."""
    print(
        f"{contact.link}: {contact.joint} pushed {contact.direction:+d}, {contact.force_text or contact.kind}"
    )


with pepper:  # connects, raises the stiffness, holds the posture
    pepper.set_posture({"LShoulderRoll": 0.6})  # radians; joints that are not named stay
    pepper.run(3.0)
    pepper.push(
        "LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=1.0
    )  # only a simulated robot can
    pepper.run(2.0)
