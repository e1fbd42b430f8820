#ifndef HYDRO_MODEL_H
#define HYDRO_MODEL_H
#define TOKEN "${token}"
#define TIME_REFERENCE ${time}u
#define COMMAND_REFERENCE ${command}u
#define LOAD_REFERENCE ${load}u
#define FIRST_REFERENCE ${first}u
#define STEP_REFUSED "the communication step must be positive${most}"
#endif
