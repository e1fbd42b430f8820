
/* A rig. It holds no pointer: a copy of it is a copy of its state. */
typedef struct plant {
    double memory[PLANT_CELLS];
#if PLANT_SENT
    struct {
        double command[2], lasted;
    } line[PLANT_SENT + 1]; /* the commands of the last steps and how long these lasted, s; the oldest first */
    int sent;
#endif
    double command[2], load[2]; /* held over the next step */
    double room[PLANT_ROOM];    /* holds nothing between calls */
} plant;

/* Parameters of the model, at rest, at time zero. */
void plant_start(plant *p);
/* At rest, at time zero; parameters stay. */
void plant_rest(plant *p);
/* Brings flow and measured speed up to date after parameters were changed. */
void plant_observe(plant *p);
/* Goes on by `period` seconds; 0, and nothing done, where that is refused: a period that is not positive and finite, or, where
   commands are delayed, more than PLANT_SENT different commands under way. A channel that cannot be followed is put to rest and
   marked in `diverged`. */
int plant_step(plant *p, double period);
/* Sets a parameter by its place in `memory`; 0 if there is none, or if the model does not accept the value. */
int plant_set(plant *p, unsigned place, double value);

#endif
