"""An independent simulator of the rig: the plain equations, integrated by SciPy's stiff solvers.

It shares no line of physics with the compiled kernel. The kernel is checked against it (`forms="same"`), and practice
logs come from it (`forms="different"`), so that a diagnosis never meets its own equations in disguise. The two forms
agree on what every parameter means and on its limits; they differ in shape, and the shape has constants (`forms.py`) that
every practice rig draws for itself:

    effect                     same form (the catalogue's)       different form
    driver_saturation          hard clip                         soft knee (p-norm)
    input_hysteresis           one play                          three plays of different width
    coil_heating               heated by i^2 of the cold coil    heated by i^2 R(t)
    magnetic_hysteresis        Bouc-Wen                          sum of stop operators (Prandtl-Ishlinskii)
    spool_stiction             larger Fc, Fs of the one bristle  second, elasto-plastic bristle (Dupont 2002)
    spool_stop                 a spring that damps               progressive, as a round end
    spring_preload             tanh                              algebraic
    flow_force                 on the spool's travel             on the flow opening, with radial clearance
    dead_zone                  sharp corners                     corners rounded by the radial clearance
    underlap                   sharp corners                     corners rounded by the radial clearance
    flow_saturation            hard clip                         p-norm
    directional_gain           kink                              blended around zero
    flow_gain_nonlinearity     gain linear in the opening        gain with a power of the opening
    pressure_dependent_flow    square root, blocked when dp > ps laminar transition, back flow when dp > ps
    supply_droop               one lag                           two lags (pump and accumulator line)
    entrained_air              isothermal                        polytropic
    line_loss, quadratic_drag  q abs(q)                          q sqrt(q^2 + small^2), laminar at low flow
    crossport_relief           kink, one lag                     rounded, slower to close, conductance grows with pressure
    external_leakage           laminar                           with a power of the pressure
    case_drain                 laminar                           with a power of the pressure
    anti_cavitation            straight from its opening on      the poppet lifts first, then a power of the pressure
    line_volume                laminar throttle                  with a power of the pressure drop
    motor_coulomb_friction     tanh with Stribeck peak           LuGre bristle on the shaft
    displacement_ripple        one cosine                        with a second harmonic
    loss models of the motor   sign(w) as tanh(10 w), root       sign(w) as w/sqrt(w^2 + small^2), laminar gap
                               smooth below 0.1 bar              in series with the turbulent one
    shaft_backlash             damper grows at first             damper grows throughout
    viscosity_drift            exponential                       faster or slower beginning, same end
    sensor_lag                 first order                       two lags with the same sum
    the others                 one form only: delay, offsets, gains, constant and eccentric torque, leakage by speed

Signals are SI, arrays (T, 2): column 0 is channel 1. Row n is the state at the instant at which command n begins to act
(row 0: rest), the convention of `plant.simulate` and of rig logs.
"""

from .rig import FORMS, REFERENCE_SIGNALS, ReferenceRig, simulate_reference

__all__ = ["FORMS", "REFERENCE_SIGNALS", "ReferenceRig", "simulate_reference"]
