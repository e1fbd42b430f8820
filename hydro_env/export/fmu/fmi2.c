/* FMI 2.0 for co-simulation around plant.h. Declarations follow the standard (Modelica Association, FMI 2.0.4); only what is used
   is declared. */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#include "plant.h"

#ifdef FMI2_FUNCTION_PREFIX
#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
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

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef enum { DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED } StatusKind;
typedef void (*Logger)(void *environment, const char *instance, Status status, const char *category, const char *message, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *object);
    void (*step_finished)(void *environment, Status status);
    void *environment;
} Callbacks;

typedef struct {
    plant rig;
    double time, start;
    int stale; /* parameters were changed since outputs were computed */
} State;

typedef struct {
    State state;
    Logger logger;
    void *environment;
    char *name;
} Instance;

static Status fail(Instance *c, const char *message) {
    if (c && c->logger) c->logger(c->environment, c->name, ERROR, "logStatusError", "%s", message);
    return ERROR;
}

static Status refuse(Instance *c, unsigned reference, double value) {
    char text[160];
    snprintf(text, sizeof(text), "fmi2SetReal: %g is no value for reference %u: a finite input, or a parameter from its min to its max, is right",
             value, reference);
    return fail(c, text);
}

static const double *cell(Instance *c, unsigned reference) {
    if (reference == TIME_REFERENCE) return &c->state.time;
    if (reference >= COMMAND_REFERENCE && reference < COMMAND_REFERENCE + 2) return &c->state.rig.command[reference - COMMAND_REFERENCE];
    if (reference >= LOAD_REFERENCE && reference < LOAD_REFERENCE + 2) return &c->state.rig.load[reference - LOAD_REFERENCE];
    if (reference >= FIRST_REFERENCE && reference < FIRST_REFERENCE + PLANT_CELLS) return &c->state.rig.memory[reference - FIRST_REFERENCE];
    return NULL;
}

EXPORT const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT const char *FMI(fmi2GetVersion)(void) { return "2.0"; }
EXPORT Status FMI(fmi2SetDebugLogging)(void *c, int on, size_t n, const char *const categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT void *FMI(fmi2Instantiate)(const char *name, int kind, const char *token, const char *resources, const Callbacks *callbacks, int visible, int logging) {
    Instance *c;
    (void)resources, (void)visible, (void)logging;
    if (kind != 1 || !token || strcmp(token, TOKEN)) return NULL;
    c = calloc(1, sizeof(Instance));
    if (!c) return NULL;
    c->name = malloc(strlen(name) + 1);
    if (!c->name) {
        free(c);
        return NULL;
    }
    strcpy(c->name, name);
    if (callbacks) {
        c->logger = callbacks->logger;
        c->environment = callbacks->environment;
    }
    plant_start(&c->state.rig);
    return c;
}

EXPORT void FMI(fmi2FreeInstance)(void *instance) {
    Instance *c = instance;
    if (!c) return;
    free(c->name);
    free(c);
}

EXPORT Status FMI(fmi2SetupExperiment)(void *c, int tolerance_given, double tolerance, double start, int stop_given, double stop) {
    (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
    ((Instance *)c)->state.start = ((Instance *)c)->state.time = start;
    return OK;
}
EXPORT Status FMI(fmi2EnterInitializationMode)(void *c) { return c ? OK : ERROR; }
EXPORT Status FMI(fmi2ExitInitializationMode)(void *c) {
    plant_observe(&((Instance *)c)->state.rig);
    return OK;
}
EXPORT Status FMI(fmi2Terminate)(void *c) { return c ? OK : ERROR; }
EXPORT Status FMI(fmi2Reset)(void *c) {
    plant_start(&((Instance *)c)->state.rig);
    ((Instance *)c)->state.time = ((Instance *)c)->state.start = 0.0;
    ((Instance *)c)->state.stale = 0;
    return OK;
}

EXPORT Status FMI(fmi2GetReal)(void *instance, const unsigned references[], size_t n, double values[]) {
    Instance *c = instance;
    size_t i;
    if (c->state.stale) plant_observe(&c->state.rig);
    c->state.stale = 0;
    for (i = 0; i < n; i++) {
        const double *found = cell(c, references[i]);
        if (!found) return fail(c, "fmi2GetReal: there is no variable with this value reference");
        values[i] = *found;
    }
    return OK;
}

EXPORT Status FMI(fmi2SetReal)(void *instance, const unsigned references[], size_t n, const double values[]) {
    Instance *c = instance;
    size_t i;
    for (i = 0; i < n; i++) {
        unsigned r = references[i];
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

EXPORT Status FMI(fmi2GetInteger)(void *c, const unsigned r[], size_t n, int v[]) { (void)r, (void)v; return n ? fail(c, "there are no integers") : OK; }
EXPORT Status FMI(fmi2GetBoolean)(void *c, const unsigned r[], size_t n, int v[]) { (void)r, (void)v; return n ? fail(c, "there are no booleans") : OK; }
EXPORT Status FMI(fmi2GetString)(void *c, const unsigned r[], size_t n, const char *v[]) { (void)r, (void)v; return n ? fail(c, "there are no strings") : OK; }
EXPORT Status FMI(fmi2SetInteger)(void *c, const unsigned r[], size_t n, const int v[]) { (void)r, (void)v; return n ? fail(c, "there are no integers") : OK; }
EXPORT Status FMI(fmi2SetBoolean)(void *c, const unsigned r[], size_t n, const int v[]) { (void)r, (void)v; return n ? fail(c, "there are no booleans") : OK; }
EXPORT Status FMI(fmi2SetString)(void *c, const unsigned r[], size_t n, const char *const v[]) { (void)r, (void)v; return n ? fail(c, "there are no strings") : OK; }

EXPORT Status FMI(fmi2GetFMUstate)(void *c, void **state) {
    if (!*state) *state = malloc(sizeof(State));
    if (!*state) return fail(c, "fmi2GetFMUstate: out of memory");
    *(State *)*state = ((Instance *)c)->state;
    return OK;
}
EXPORT Status FMI(fmi2SetFMUstate)(void *c, void *state) {
    ((Instance *)c)->state = *(State *)state;
    return OK;
}
EXPORT Status FMI(fmi2FreeFMUstate)(void *c, void **state) {
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}
EXPORT Status FMI(fmi2SerializedFMUstateSize)(void *c, void *state, size_t *size) {
    (void)c, (void)state;
    *size = sizeof(State);
    return OK;
}
EXPORT Status FMI(fmi2SerializeFMUstate)(void *c, void *state, char bytes[], size_t size) {
    if (size != sizeof(State)) return fail(c, "fmi2SerializeFMUstate: wrong size");
    memcpy(bytes, state, size);
    return OK;
}
EXPORT Status FMI(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state) {
    if (size != sizeof(State)) return fail(c, "fmi2DeSerializeFMUstate: wrong size");
    if (!*state) *state = malloc(sizeof(State));
    if (!*state) return fail(c, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(*state, bytes, size);
    return OK;
}

EXPORT Status FMI(fmi2GetDirectionalDerivative)(void *c, const unsigned u[], size_t nu, const unsigned k[], size_t nk, const double dk[], double du[]) {
    (void)u, (void)nu, (void)k, (void)nk, (void)dk, (void)du;
    return fail(c, "there are no directional derivatives");
}
EXPORT Status FMI(fmi2SetRealInputDerivatives)(void *c, const unsigned r[], size_t n, const int order[], const double v[]) {
    (void)r, (void)n, (void)order, (void)v;
    return fail(c, "inputs are held, not interpolated");
}
EXPORT Status FMI(fmi2GetRealOutputDerivatives)(void *c, const unsigned r[], size_t n, const int order[], double v[]) {
    (void)r, (void)n, (void)order, (void)v;
    return fail(c, "there are no derivatives of outputs");
}

EXPORT Status FMI(fmi2DoStep)(void *instance, double now, double step, int no_return) {
    Instance *c = instance;
    (void)no_return;
    if (!plant_step(&c->state.rig, step)) return fail(c, "fmi2DoStep: " STEP_REFUSED);
    c->state.time = now + step;
    c->state.stale = 0;
    return OK;
}
EXPORT Status FMI(fmi2CancelStep)(void *c) { return fail(c, "a step is never pending"); }
EXPORT Status FMI(fmi2GetStatus)(void *c, StatusKind kind, Status *value) {
    (void)c, (void)kind;
    *value = OK;
    return OK;
}
EXPORT Status FMI(fmi2GetRealStatus)(void *c, StatusKind kind, double *value) {
    if (kind != LAST_SUCCESSFUL_TIME) return DISCARD;
    *value = ((Instance *)c)->state.time;
    return OK;
}
EXPORT Status FMI(fmi2GetIntegerStatus)(void *c, StatusKind kind, int *value) {
    (void)c, (void)kind, (void)value;
    return DISCARD;
}
EXPORT Status FMI(fmi2GetBooleanStatus)(void *c, StatusKind kind, int *value) {
    (void)c;
    if (kind != TERMINATED) return DISCARD;
    *value = 0;
    return OK;
}
EXPORT Status FMI(fmi2GetStringStatus)(void *c, StatusKind kind, const char **value) {
    (void)c, (void)kind, (void)value;
    return DISCARD;
}
