"""A rig that is really there: a controller of the package, or an experiment, drives it over OPC UA or UDP within limits.

link        the link file: protocol, nodes or fields with their units, limits, watchdog, what sensors may show
supervisor  what is written to the valves: limits, plausibility, watchdog, a fault that stays; it knows no clock and no network
transports  OPC UA and UDP
driver      what asks for commands: a controller with a set-point, or an experiment
log         the rig log that grows, what happened beside it, and how both are followed
run         the loop

Only `transports` needs the extra `live`, for OPC UA.
"""
