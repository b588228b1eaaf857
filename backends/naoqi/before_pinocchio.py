"""Imported for what it does: loads NAOqi's library, where it is installed, before pinocchio.

Both bring boost::asio, of different versions (qi 3.1.5: 1.83, pin 4.1: 1.90), with symbols that are one for the whole
process (STB_GNU_UNIQUE): those that come first serve both. With pinocchio's, libqi corrupts memory, and the process
crashes when a connection is lost while calls are under way (15 of 15 times); with libqi's nothing happens, since
pinocchio's Python package never runs asio. ``RTLD_LOCAL`` does not help against such symbols.
"""

from contextlib import suppress

from pepper_driver.backends.naoqi.qi_library import load_qi

with suppress(ImportError):  # not installed, or too late: told when a robot is asked for
    load_qi()
