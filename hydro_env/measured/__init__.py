"""Logs of real rigs: reading, mapping foreign columns to signals in SI, and a gate that says what is wrong."""

from hydro_env.measured.finding import Finding
from hydro_env.measured.log import RigLog
from hydro_env.measured.log_files import read_log, write_log
from hydro_env.measured.mapping import Mapping, load_mapping

__all__ = ["Finding", "Mapping", "RigLog", "load_mapping", "read_log", "write_log"]
