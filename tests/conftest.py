"""What holds for all tests."""

import signal

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
