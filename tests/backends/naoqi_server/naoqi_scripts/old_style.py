#! /usr/bin/env python
"""A module in the old style: ALMemory calls it back by its name when an event is raised."""

import argparse
import threading

import qi


class BumperReaction(object):
    """Stands still when its back is hit, and counts."""

    def __init__(self, session):
        self.memory = session.service("ALMemory")
        self.motion = session.service("ALMotion")
        self.hit = threading.Event()

    def start(self):
        self.memory.declareEvent("BumperReaction/Hits")
        self.memory.insertData("BumperReaction/Hits", 0)
        self.memory.subscribeToEvent("BackBumperPressed", "BumperReaction", "onBumper")

    def onBumper(self, name, value, message):
        if value:
            self.memory.unsubscribeToEvent("BackBumperPressed", "BumperReaction")
            self.motion.killMove()
            self.memory.raiseEvent("BumperReaction/Hits", 1)
            print(name, value, repr(message), flush=True)
            self.hit.set()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--ip", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9559)
    args = parser.parse_args()
    session = qi.Session()
    session.connect("tcp://%s:%d" % (args.ip, args.port))
    reaction = BumperReaction(session)
    number = session.registerService("BumperReaction", reaction)
    reaction.start()
    print("waiting", flush=True)
    reaction.hit.wait(20)
    print("hits", reaction.memory.getData("BumperReaction/Hits"))
    session.unregisterService(number)
    session.close()
