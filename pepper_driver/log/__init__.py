"""The log of a run: one MCAP file that Lichtblick, Foxglove and PlotJuggler open as it is."""

from pepper_driver.backends.log_file import LogError
from pepper_driver.log.reader import RunLog, read_log
from pepper_driver.log.summary import run_metadata
from pepper_driver.log.topics import Label, LogEvent
from pepper_driver.log.writer import LogWriter

__all__ = ["Label", "LogError", "LogEvent", "LogWriter", "RunLog", "read_log", "run_metadata"]
