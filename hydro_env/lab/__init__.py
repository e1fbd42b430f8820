"""`hydro-env lab`: a rig that runs on a page of this machine, and logs that are diagnosed there.

rig        one rig in motion, whose valves, effects, set-point and loads may change at every control period
adjust     what a slider of an effect stands for, from the catalogue
session    rig, controller and course together, period by period, with what was seen of late
recording  a log of the session, as CSV
worker     the session in a thread of its own, in step with the clock
jobs       a diagnosis in a process of its own, with progress and cancel
diagnosis_process  what that process does
guard      who may talk to the page: this machine, and no other site's scripts
page       the page; `motors` is its moving picture
server     the web server

Everything but `motors`, `page` and `server` works without the extra `lab`.
"""
