/* FMI 3.0 for co-simulation around plant.h. Declarations follow the standard (Modelica Association, FMI 3.0.2); only what is used
   is declared. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#include "plant.h"

#ifdef FMI3_FUNCTION_PREFIX
#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void (*Logger)(void *environment, Status status, const char *category, const char *message);
typedef uint32_t Ref;

typedef struct {
    plant rig;
    double time;
    int stale; /* parameters were changed since outputs were computed */
} State;

typedef struct {
    State state;
    Logger logger;
    void *environment;
} Instance;

static Status fail(Instance *c, const char *message) {
    if (c && c->logger) c->logger(c->environment, ERROR, "logStatusError", message);
    return ERROR;
}

static Status refuse(Instance *c, Ref reference, double value) {
    char text[160];
    snprintf(text, sizeof(text), "fmi3SetFloat64: %g is no value for reference %u: a finite input, or a parameter from its min to its max, is right",
             value, (unsigned)reference);
    return fail(c, text);
}

static const double *cell(Instance *c, Ref reference) {
    if (reference == TIME_REFERENCE) return &c->state.time;
    if (reference >= COMMAND_REFERENCE && reference < COMMAND_REFERENCE + 2) return &c->state.rig.command[reference - COMMAND_REFERENCE];
    if (reference >= LOAD_REFERENCE && reference < LOAD_REFERENCE + 2) return &c->state.rig.load[reference - LOAD_REFERENCE];
    if (reference >= FIRST_REFERENCE && reference < FIRST_REFERENCE + PLANT_CELLS) return &c->state.rig.memory[reference - FIRST_REFERENCE];
    return NULL;
}

EXPORT const char *FMI(fmi3GetVersion)(void) { return "3.0"; }
EXPORT Status FMI(fmi3SetDebugLogging)(void *c, bool on, size_t n, const char *const categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT void *FMI(fmi3InstantiateCoSimulation)(const char *name, const char *token, const char *resources, bool visible, bool logging, bool events, bool early, const Ref required[], size_t n, void *environment, Logger logger, void *update) {
    Instance *c;
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n, (void)update;
    if (!token || strcmp(token, TOKEN)) return NULL;
    c = calloc(1, sizeof(Instance));
    if (!c) return NULL;
    c->logger = logger;
    c->environment = environment;
    plant_start(&c->state.rig);
    return c;
}
EXPORT void *FMI(fmi3InstantiateModelExchange)(const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment, Logger logger) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)logger;
    return NULL;
}
EXPORT void *FMI(fmi3InstantiateScheduledExecution)(const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment, Logger logger, void *update, void *lock, void *unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)logger, (void)update, (void)lock, (void)unlock;
    return NULL;
}
EXPORT void FMI(fmi3FreeInstance)(void *c) { free(c); }

EXPORT Status FMI(fmi3EnterInitializationMode)(void *c, bool tolerance_given, double tolerance, double start, bool stop_given, double stop) {
    (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
    ((Instance *)c)->state.time = start;
    return OK;
}
EXPORT Status FMI(fmi3ExitInitializationMode)(void *c) {
    plant_observe(&((Instance *)c)->state.rig);
    return OK;
}
EXPORT Status FMI(fmi3EnterEventMode)(void *c) { return fail(c, "there are no events"); }
EXPORT Status FMI(fmi3EnterStepMode)(void *c) { return c ? OK : ERROR; }
EXPORT Status FMI(fmi3EnterConfigurationMode)(void *c) { return fail(c, "there are no structural parameters"); }
EXPORT Status FMI(fmi3ExitConfigurationMode)(void *c) { return fail(c, "there are no structural parameters"); }
EXPORT Status FMI(fmi3Terminate)(void *c) { return c ? OK : ERROR; }
EXPORT Status FMI(fmi3Reset)(void *c) {
    plant_start(&((Instance *)c)->state.rig);
    ((Instance *)c)->state.time = 0.0;
    ((Instance *)c)->state.stale = 0;
    return OK;
}

EXPORT Status FMI(fmi3GetFloat64)(void *instance, const Ref references[], size_t n, double values[], size_t sizes) {
    Instance *c = instance;
    size_t i;
    if (sizes != n) return fail(c, "fmi3GetFloat64: every variable is one number");
    if (c->state.stale) plant_observe(&c->state.rig);
    c->state.stale = 0;
    for (i = 0; i < n; i++) {
        const double *found = cell(c, references[i]);
        if (!found) return fail(c, "fmi3GetFloat64: there is no variable with this value reference");
        values[i] = *found;
    }
    return OK;
}

EXPORT Status FMI(fmi3SetFloat64)(void *instance, const Ref references[], size_t n, const double values[], size_t sizes) {
    Instance *c = instance;
    size_t i;
    if (sizes != n) return fail(c, "fmi3SetFloat64: every variable is one number");
    for (i = 0; i < n; i++) {
        Ref r = references[i];
        double value = values[i];
        if (r >= COMMAND_REFERENCE && r < LOAD_REFERENCE + 2) {
            if (value - value != 0.0) return refuse(c, r, value);
            *(double *)cell(c, r) = value;
        } else {
            if (r < FIRST_REFERENCE || !plant_set(&c->state.rig, r - FIRST_REFERENCE, value)) return refuse(c, r, value);
            c->state.stale = 1;
        }
    }
    return OK;
}

#define NONE_OF(kind, type) \
    EXPORT Status FMI(fmi3Get##kind)(void *c, const Ref r[], size_t n, type v[], size_t sizes) { \
        (void)r, (void)v, (void)sizes; \
        return n ? fail(c, "there are only variables of the type Float64") : OK; \
    } \
    EXPORT Status FMI(fmi3Set##kind)(void *c, const Ref r[], size_t n, const type v[], size_t sizes) { \
        (void)r, (void)v, (void)sizes; \
        return n ? fail(c, "there are only variables of the type Float64") : OK; \
    }
typedef const char *Text;
NONE_OF(Float32, float)
NONE_OF(Int8, int8_t)
NONE_OF(UInt8, uint8_t)
NONE_OF(Int16, int16_t)
NONE_OF(UInt16, uint16_t)
NONE_OF(Int32, int32_t)
NONE_OF(UInt32, uint32_t)
NONE_OF(Int64, int64_t)
NONE_OF(UInt64, uint64_t)
NONE_OF(Boolean, bool)
NONE_OF(String, Text)
EXPORT Status FMI(fmi3GetBinary)(void *c, const Ref r[], size_t n, size_t lengths[], const uint8_t *v[], size_t sizes) {
    (void)r, (void)lengths, (void)v, (void)sizes;
    return n ? fail(c, "there are only variables of the type Float64") : OK;
}
EXPORT Status FMI(fmi3SetBinary)(void *c, const Ref r[], size_t n, const size_t lengths[], const uint8_t *const v[], size_t sizes) {
    (void)r, (void)lengths, (void)v, (void)sizes;
    return n ? fail(c, "there are only variables of the type Float64") : OK;
}
EXPORT Status FMI(fmi3GetClock)(void *c, const Ref r[], size_t n, bool v[]) { (void)r, (void)v; return n ? fail(c, "there are no clocks") : OK; }
EXPORT Status FMI(fmi3SetClock)(void *c, const Ref r[], size_t n, const bool v[]) { (void)r, (void)v; return n ? fail(c, "there are no clocks") : OK; }

EXPORT Status FMI(fmi3GetNumberOfVariableDependencies)(void *c, Ref r, size_t *n) { (void)r, (void)n; return fail(c, "dependencies are not listed"); }
EXPORT Status FMI(fmi3GetVariableDependencies)(void *c, Ref r, size_t a[], Ref b[], size_t d[], int kinds[], size_t n) {
    (void)r, (void)a, (void)b, (void)d, (void)kinds, (void)n;
    return fail(c, "dependencies are not listed");
}

EXPORT Status FMI(fmi3GetFMUState)(void *c, void **state) {
    if (!*state) *state = malloc(sizeof(State));
    if (!*state) return fail(c, "fmi3GetFMUState: out of memory");
    *(State *)*state = ((Instance *)c)->state;
    return OK;
}
EXPORT Status FMI(fmi3SetFMUState)(void *c, void *state) {
    ((Instance *)c)->state = *(State *)state;
    return OK;
}
EXPORT Status FMI(fmi3FreeFMUState)(void *c, void **state) {
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}
EXPORT Status FMI(fmi3SerializedFMUStateSize)(void *c, void *state, size_t *size) {
    (void)c, (void)state;
    *size = sizeof(State);
    return OK;
}
EXPORT Status FMI(fmi3SerializeFMUState)(void *c, void *state, uint8_t bytes[], size_t size) {
    if (size != sizeof(State)) return fail(c, "fmi3SerializeFMUState: wrong size");
    memcpy(bytes, state, size);
    return OK;
}
EXPORT Status FMI(fmi3DeserializeFMUState)(void *c, const uint8_t bytes[], size_t size, void **state) {
    if (size != sizeof(State)) return fail(c, "fmi3DeserializeFMUState: wrong size");
    if (!*state) *state = malloc(sizeof(State));
    if (!*state) return fail(c, "fmi3DeserializeFMUState: out of memory");
    memcpy(*state, bytes, size);
    return OK;
}

EXPORT Status FMI(fmi3GetDirectionalDerivative)(void *c, const Ref u[], size_t nu, const Ref k[], size_t nk, const double seed[], size_t ns, double s[], size_t n) {
    (void)u, (void)nu, (void)k, (void)nk, (void)seed, (void)ns, (void)s, (void)n;
    return fail(c, "there are no directional derivatives");
}
EXPORT Status FMI(fmi3GetAdjointDerivative)(void *c, const Ref u[], size_t nu, const Ref k[], size_t nk, const double seed[], size_t ns, double s[], size_t n) {
    (void)u, (void)nu, (void)k, (void)nk, (void)seed, (void)ns, (void)s, (void)n;
    return fail(c, "there are no adjoint derivatives");
}
EXPORT Status FMI(fmi3GetOutputDerivatives)(void *c, const Ref r[], size_t n, const int32_t orders[], double v[], size_t sizes) {
    (void)r, (void)n, (void)orders, (void)v, (void)sizes;
    return fail(c, "there are no derivatives of outputs");
}

EXPORT Status FMI(fmi3GetIntervalDecimal)(void *c, const Ref r[], size_t n, double v[], int q[]) { (void)r, (void)n, (void)v, (void)q; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3GetIntervalFraction)(void *c, const Ref r[], size_t n, uint64_t a[], uint64_t b[], int q[]) { (void)r, (void)n, (void)a, (void)b, (void)q; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3GetShiftDecimal)(void *c, const Ref r[], size_t n, double v[]) { (void)r, (void)n, (void)v; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3GetShiftFraction)(void *c, const Ref r[], size_t n, uint64_t a[], uint64_t b[]) { (void)r, (void)n, (void)a, (void)b; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3SetIntervalDecimal)(void *c, const Ref r[], size_t n, const double v[]) { (void)r, (void)n, (void)v; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3SetIntervalFraction)(void *c, const Ref r[], size_t n, const uint64_t a[], const uint64_t b[]) { (void)r, (void)n, (void)a, (void)b; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3SetShiftDecimal)(void *c, const Ref r[], size_t n, const double v[]) { (void)r, (void)n, (void)v; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3SetShiftFraction)(void *c, const Ref r[], size_t n, const uint64_t a[], const uint64_t b[]) { (void)r, (void)n, (void)a, (void)b; return fail(c, "there are no clocks"); }
EXPORT Status FMI(fmi3EvaluateDiscreteStates)(void *c) { return fail(c, "there are no discrete states"); }
EXPORT Status FMI(fmi3UpdateDiscreteStates)(void *c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t) {
    (void)c, (void)t;
    *a = *b = *d = *e = *f = false;
    return OK;
}
/* Of the other interface types, which some importers look up as well. */
EXPORT Status FMI(fmi3EnterContinuousTimeMode)(void *c) { return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3CompletedIntegratorStep)(void *c, bool a, bool *b, bool *d) { (void)a, (void)b, (void)d; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3SetTime)(void *c, double t) { (void)t; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3SetContinuousStates)(void *c, const double x[], size_t n) { (void)x, (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetContinuousStateDerivatives)(void *c, double x[], size_t n) { (void)x, (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetEventIndicators)(void *c, double x[], size_t n) { (void)x, (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetContinuousStates)(void *c, double x[], size_t n) { (void)x, (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetNominalsOfContinuousStates)(void *c, double x[], size_t n) { (void)x, (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetNumberOfEventIndicators)(void *c, size_t *n) { (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3GetNumberOfContinuousStates)(void *c, size_t *n) { (void)n; return fail(c, "this is for co-simulation only"); }
EXPORT Status FMI(fmi3ActivateModelPartition)(void *c, Ref clock, double time) { (void)clock, (void)time; return fail(c, "there are no clocks"); }

EXPORT Status FMI(fmi3DoStep)(void *instance, double now, double step, bool no_return, bool *event, bool *terminate, bool *early, double *last) {
    Instance *c = instance;
    (void)no_return;
    *event = *terminate = *early = false;
    *last = now;
    if (!plant_step(&c->state.rig, step)) return fail(c, "fmi3DoStep: " STEP_REFUSED);
    *last = c->state.time = now + step;
    c->state.stale = 0;
    return OK;
}
