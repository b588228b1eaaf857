#! /usr/bin/env python
"""An application that says where it was touched. It ends after the first touch."""

import argparse
import functools
import threading

import qi


class ReactToTouch(object):
    def __init__(self, app):
        app.start()
        self.done = threading.Event()
        self.memory = app.session.service("ALMemory")
        self.tts = app.session.service("ALTextToSpeech")
        self.leds = app.session.service("ALLeds")
        self.touch = self.memory.subscriber("TouchChanged")
        self.link = self.touch.signal.connect(functools.partial(self.on_touched, "TouchChanged"))
        print("waiting", flush=True)

    def on_touched(self, name, value):
        touched = [part for part, down in value if down]
        if not touched:
            return
        self.touch.signal.disconnect(self.link)
        self.leds.fadeRGB("FaceLeds", "magenta", 0.2)
        self.tts.say("My " + " and my ".join(touched) + " was touched")
        print(name, touched, flush=True)
        self.done.set()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--ip", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9559)
    args = parser.parse_args()
    app = qi.Application(["ReactToTouch", "--qi-url=tcp://%s:%d" % (args.ip, args.port)])
    reaction = ReactToTouch(app)
    reaction.done.wait(20)
    app.session.close()
    app.stop()
