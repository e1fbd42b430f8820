#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "compile without -ffast-math, which cannot tell that an input is NaN"
#endif

void ${name}_reset(${name}_state *s) {
    int i;
    *s = (${name}_state){0};
    for (i = 0; i < ${measured}; i++) s->missed[i] = ${guard}_HOLD + 1;
}

int ${name}_step(${name}_state *s, const double measured[${measured}], double command[2]) {
    int i;
    s->fault = 0;
    for (i = 0; i < ${measured}; i++) {
        if (fabs(measured[i]) <= ${most}) {
            s->input[i] = measured[i];
            s->missed[i] = 0;
        } else if (s->missed[i] <= ${guard}_HOLD) {
            s->missed[i]++;
        }
        if (s->missed[i] > ${guard}_HOLD) s->fault = 1;
    }
    if (s->fault) {
        command[0] = command[1] = 0.0;
    } else if (s->started) {
        next_sample(s, s->input, command);
    } else {
        first_sample(s, s->input, command);
        s->started = 1;
    }
    return s->fault;
}
