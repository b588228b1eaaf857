"""The robot in a browser: a page that shows a running robot or a log, and a hand that is a mouse.

``view.py`` is for the robot's process; ``live.py`` and ``recorded.py`` are the pages, which need the extra ``viewer``.
Nothing is imported here: the process of the page shall not load the robot.
"""

NO_OBSERVER = "none"
"""In place of the name of an observer."""
