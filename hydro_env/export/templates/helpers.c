static inline int py_mod(int a, int b) { int r = a % b; return r != 0 && (r < 0) != (b < 0) ? r + b : r; }

static inline int py_div(int a, int b) { return (a - py_mod(a, b)) / b; }

static inline int py_min_int(int a, int b) { return b < a ? b : a; }

static inline int py_max_int(int a, int b) { return b > a ? b : a; }

static inline int py_abs_int(int a) { return a < 0 ? -a : a; }

static inline double py_sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }

static inline int py_argmin(const double *a, int n) {
    int i, found = 0;
    for (i = 1; i < n; i++)
        if (a[i] < a[found]) found = i;
    return found;
}

static inline double py_min(double a, double b) { return b < a ? b : a; }

static inline double py_max(double a, double b) { return b > a ? b : a; }
