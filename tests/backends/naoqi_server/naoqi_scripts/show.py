#! /usr/bin/env python
"""Pepper speaks, lights up, shows a picture and prints its state."""

import argparse
import time

import qi


def main(session):
    tts = session.service("ALTextToSpeech")
    animated = session.service("ALAnimatedSpeech")
    leds = session.service("ALLeds")
    tablet = session.service("ALTabletService")
    memory = session.service("ALMemory")
    awareness = session.service("ALBasicAwareness")
    system = session.service("ALSystem")

    awareness.setEnabled(False)
    print(
        "version",
        system.systemVersion().split(".")[0],
        "battery",
        0 < session.service("ALBattery").getBatteryCharge() <= 100,
    )

    done = []
    subscriber = memory.subscriber("ALTextToSpeech/TextDone")
    subscriber.signal.connect(lambda value: done.append(value))

    tts.setLanguage("German")
    tts.setVolume(0.7)
    tts.setParameter("speed", 200)
    tts.say("\\rspd=90\\ Guten Tag!")
    tts.say("Good bye", "English")
    while done.count(1) < 2:  # events take their own way
        time.sleep(0.05)
    print("language", tts.getLanguage(), "done", done.count(1))
    animated.say(
        "Hello ^start(animations/Stand/Gestures/Hey_1) everybody",
        {"bodyLanguageMode": "contextual"},
    )

    tablet.showImage("http://%s/apps/picture/image.png" % tablet.robotIp())
    leds.fadeRGB("FaceLeds", 0x0000FF00, 0.3)
    leds.rotateEyes(0x00FF0000, 0.5, 0.5)
    leds.fade("EarLeds", 0.5, 0.2)
    leds.setIntensity("LeftFaceLedsBlue", 1.0)
    leds.off("ChestLeds")
    print("ears", round(leds.getIntensity("RightEarLeds"), 1))
    leds.on("AllLeds")
    tablet.hideImage()
    print("touched", [name for name, down in session.service("ALTouch").getStatus() if down])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--ip", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9559)
    args = parser.parse_args()
    session = qi.Session()
    session.connect("tcp://%s:%d" % (args.ip, args.port))
    main(session)
