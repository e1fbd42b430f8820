"""`hydro-env lab`: a rig that runs on a page of this machine, and logs that are diagnosed there.

rig        one rig in motion, whose valves, effects, set-point and loads may change at every control period
adjust     what a slider of an effect stands for, from the catalogue
session    rig, controller and scenario together, period by period, with the signals of the last seconds, and logs of it as CSV
worker     the session in a thread of its own, in step with the clock
jobs       a diagnosis in a process of its own, with progress and cancel
uploads    files that the page was given
guard      who may talk to the page: this machine, and no other site's scripts
page       the page; `elements` are its parts, `diagnosis_page` is that of logs
live_page  the page of a run of `hydro-env live`, whose log it follows
server     the web server

`rig`, `adjust`, `session`, `worker`, `jobs` and `uploads` work without the extra `lab`.
"""
