static const double initial[PLANT_CELLS] = {
    ${initial}};

/* How many channels a parameter belongs to by itself (0: a signal, 1, or 2 that share it), and its neutral, least and greatest
   value. */
static const struct {
    int channels;
    double neutral, least, greatest;
} settable[PLANT_CELLS / 2] = {
    ${settable}};

/* Places in `room` that the loop over steps knows, and the sweeps of the kernel, for a plant `p`. */
${known}

static void enter(plant *p) {
    int i;
    for (i = 0; i < PLANT_CELLS; i++) p->room[i] = p->memory[i];
    PRECOMPUTE;
}

static void leave(plant *p) {
    int i;
    OBSERVE;
    for (i = 0; i < MOVING; i++) p->memory[i] = p->room[i];
}

#if PLANT_SENT
/* Where the time of a channel has come, the command of that time goes to the valve, until another one's time comes. */
static int arrive(plant *p, double period) {
    double *const room = p->room;
    int c, more = 0;
    for (c = 0; c < 2; c++) {
        double now = period - room[ROW_LEFT + c], wait = room[DELAY + c], until = period, begun;
        int n = p->sent - 1;
        if (room[TODO + c] > 0.0 || room[ROW_LEFT + c] <= 0.0) continue;
        for (begun = period - p->line[n].lasted; n > 0 && begun + wait > now + 1e-6 * period; begun -= p->line[--n].lasted)
            if (p->line[n - 1].command[c] != p->line[n].command[c]) until = begun + wait;
        room[APPLIED + c] = p->line[n].command[c];
        room[TODO + c] = until >= (1.0 - 1e-6) * period ? room[ROW_LEFT + c] : until - now;
        room[FRESH + c] = 1.0;
        more = 1;
    }
    for (c = 0; c < 2 && more; c++) {
        if (ARE_COUPLED && room[TODO + 1 - c] < room[TODO + c])
            room[TODO + c] = room[TODO + 1 - c]; /* channels that act on each other go equally far */
        if (room[FRESH + c] > 0.0) room[ROW_LEFT + c] -= room[TODO + c];
    }
    return more;
}

/* Puts a step into the line. Where this is full, those go that are through to every valve, or else those whose commands equal the
   ones before; 0 if there is none. */
static int send(plant *p, double period) {
    double ago = 0.0;
    int c, n, i, first = p->sent++;
    p->line[first].lasted = period;
    for (c = 0; c < 2; c++) {
        p->line[first].command[c] = p->room[COMMAND + c];
        p->room[ROW_LEFT + c] = period;
        p->room[TODO + c] = 0.0;
    }
    if (p->sent > PLANT_SENT) {
        while (first > 0 && ago < MAX_DELAY) ago += p->line[--first].lasted;
        p->line[0] = p->line[first];
        for (n = 0, i = first + 1; i < p->sent; i++) {
            int same = p->line[i].command[0] == p->line[n].command[0] && p->line[i].command[1] == p->line[n].command[1];
            if (same && first == 0)
                p->line[n].lasted += p->line[i].lasted;
            else
                p->line[++n] = p->line[i];
        }
        p->sent = n < PLANT_SENT ? n + 1 : PLANT_SENT;
        if (n == PLANT_SENT) return 0;
    }
    arrive(p, period);
    return 1;
}
#endif

void plant_observe(plant *p) {
    enter(p);
    leave(p);
}

void plant_rest(plant *p) {
    int i;
    for (i = 0; i < MOVING; i++) p->memory[i] = 0.0;
#if PLANT_SENT
    p->line[0].command[0] = p->line[0].command[1] = 0.0;
    p->line[0].lasted = INFINITY;
    p->sent = 1;
#endif
    p->command[0] = p->command[1] = p->load[0] = p->load[1] = 0.0;
    plant_observe(p);
}

void plant_start(plant *p) {
    int i;
    for (i = 0; i < PLANT_CELLS; i++) p->memory[i] = initial[i];
    for (i = 0; i < PLANT_ROOM; i++) p->room[i] = 0.0;
    plant_rest(p);
}

int plant_step(plant *p, double period) {
    double *const room = p->room, attempts = MAX_ATTEMPTS + floor(MAX_ATTEMPTS_PER_S * period);
    int c;
    if (!(period > 0.0) || period - period != 0.0) return 0;
    enter(p);
    for (c = 0; c < 2; c++) {
        room[COMMAND + c] = p->command[c];
        room[LOAD + c] = p->load[c];
    }
    START_ROW;
#if PLANT_SENT
    if (!send(p, period)) return 0;
#endif
    EVALUATE;
    for (; (room[TODO] > 0.0 || room[TODO + 1] > 0.0) && attempts > 0.0; attempts -= 1.0) {
        ATTEMPT_STEP;
#if PLANT_SENT
        if (arrive(p, period)) {
            EVALUATE;
        }
#endif
    }
    RESET_DIVERGED;
    leave(p);
    return 1;
}

int plant_set(plant *p, unsigned place, double value) {
    unsigned n = place / 2;
    if (place >= PLANT_CELLS || !settable[n].channels) return 0;
    if (value != settable[n].neutral && !(settable[n].least <= value && value <= settable[n].greatest)) return 0;
    p->memory[place] = value;
    if (settable[n].channels == 2) p->memory[place ^ 1u] = value;
    return 1;
}
