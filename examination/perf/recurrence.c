/* The recurrence of the package's compiled core as a plain C loop: what `./bench perf` calls the
 * limit. Wires on sides that give or are clamped; heat, phase and stress as in the contract, with
 * latent heat, a resistance that depends on phase and temperature, and a heat transfer that grows
 * with temperature. It holds what these cases need and no more: other effects, grains that do not
 * transform alike, and checks of the input are left out.
 */
#include <math.h>

#define MOST_WIRES 8
#define PI 3.14159265358979323846
#define NEWTON_STEP 1e-10
#define NEWTON_LIMIT 15
#define BISECTION_LIMIT 200
#define BRACKET 1e-15
#define LARGEST_STRAIN 1e6
#define LEAST 0.05

struct model { /* one material for all wires, SI */
    double ambient, heating, time_constant, latent_rise;
    double austenite_finish, austenite_slope, austenite_shift;
    double martensite_finish, martensite_slope, martensite_shift;
    double austenite_modulus, modulus_change, recoverable_strain, expansion;
    double effects, capacity, loss, resistance;
    double austenite_resistance, resistance_slope, convection_rise;
};

struct wire {
    double temperature, fraction, stress, trend, change;
    double phase_reversed, own_reversed, other_reversed, other_position_reversed;
    double decay, lag, start, guess, step, coupling;
    int side;
};

struct side {
    double stiffness, contraction, change;
};

struct slopes {
    double error, slope, coupling, stress, stress_slope, modulus;
};

static double clamp(double value) { return value < 0.0 ? 0.0 : value > 1.0 ? 1.0 : value; }

static double ramp(double position, double *slope) {
    *slope = 0.0;
    if (position <= 0.0)
        return 0.0;
    if (position >= 1.0)
        return 1.0;
    double root = sin(0.5 * PI * position);
    *slope = PI * root * sqrt(1.0 - root * root);
    return root * root;
}

static void positions(const struct model *m, double temperature, double stress, double at[2]) {
    at[0] = (m->austenite_finish - temperature + stress * m->austenite_shift) * m->austenite_slope;
    at[1] = (temperature - stress * m->martensite_shift - m->martensite_finish)
        * m->martensite_slope;
}

/* What is left of the vanishing phase since the reversal, and its slopes along both positions. */
static double phase_left(const struct wire *w, double own, double other, double by[2]) {
    double share_slope, rest_slope, left = 0.0;
    double share = ramp(own, &share_slope);
    by[0] = by[1] = 0.0;
    if (w->own_reversed > 0.0) {
        double scale = w->phase_reversed / w->own_reversed;
        left = share * scale;
        by[0] = share_slope * scale;
    } else if (w->phase_reversed > 0.0 && w->other_reversed < 1.0) {
        double scale = w->phase_reversed / (1.0 - w->other_reversed);
        left = (1.0 - ramp(other, &rest_slope)) * scale;
        by[1] = -rest_slope * scale;
    }
    if (other < w->other_position_reversed && w->other_reversed > 0.0 && share > left) {
        double bound = 1.0 - ramp(other, &rest_slope) / w->other_reversed;
        if (bound >= share) {
            left = share;
            by[0] = share_slope;
            by[1] = 0.0;
        } else if (bound > left) {
            left = bound;
            by[0] = 0.0;
            by[1] = -rest_slope / w->other_reversed;
        }
    }
    if (left > 1.0) {
        by[0] = by[1] = 0.0;
        return 1.0;
    }
    return left;
}

static double fraction(const struct model *m, const struct wire *w, double temperature,
                       double stress, double *by_temperature, double *by_stress) {
    double at[2], by[2], xi, by_f, by_g;
    positions(m, temperature, stress, at);
    if (w->trend > 0.0) {
        xi = phase_left(w, at[0], at[1], by);
        by_f = by[0];
        by_g = by[1];
    } else {
        xi = 1.0 - phase_left(w, at[1], at[0], by);
        by_f = -by[1];
        by_g = -by[0];
    }
    by_f *= m->austenite_slope;
    by_g *= m->martensite_slope;
    *by_temperature = by_g - by_f;
    *by_stress = by_f * m->austenite_shift - by_g * m->martensite_shift;
    return xi;
}

static void reverse(const struct model *m, struct wire *w, double trend) {
    double at[2], unused;
    positions(m, w->temperature, w->stress, at);
    double f = ramp(at[0], &unused), g = ramp(at[1], &unused);
    int rising = trend > 0.0;
    w->trend = trend;
    w->change = 0.0;
    w->phase_reversed = rising ? w->fraction : 1.0 - w->fraction;
    w->own_reversed = rising ? f : g;
    w->other_reversed = rising ? g : f;
    w->other_position_reversed = rising ? at[1] : at[0];
}

static struct slopes residual(const struct model *m, const struct wire *w, double contraction,
                              double xi) {
    struct slopes s;
    double by_temperature, by_stress;
    double temperature = w->start + w->lag * xi;
    double stretch = m->recoverable_strain * (1.0 - xi) - contraction;
    s.modulus = m->austenite_modulus + xi * m->modulus_change;
    s.stress = s.modulus * stretch + m->expansion * (temperature - m->ambient);
    s.stress_slope = m->modulus_change * stretch - m->recoverable_strain * s.modulus
        + m->expansion * w->lag;
    s.error = xi - fraction(m, w, temperature, s.stress, &by_temperature, &by_stress);
    s.slope = 1.0 - by_temperature * w->lag - by_stress * s.stress_slope;
    s.coupling = by_stress * s.modulus;
    return s;
}

/* xi at a given contraction, from its guess: Newton within a shrinking bracket. */
static double solve_wire(const struct model *m, const struct wire *w, double contraction) {
    double xi = w->guess, low = -1.0, high = 2.0;
    for (int k = 0; k < BISECTION_LIMIT; k++) {
        struct slopes r = residual(m, w, contraction, xi);
        double step = r.slope > 0.0 ? r.error / r.slope : 2.0;
        if (fabs(step) < NEWTON_STEP)
            return clamp(xi - step);
        if (r.error > 0.0)
            high = xi;
        else
            low = xi;
        xi -= step;
        if (k > NEWTON_LIMIT || !(low < xi && xi < high)) {
            xi = 0.5 * (low + high);
            if (high - low < BRACKET)
                break;
        }
    }
    return clamp(xi);
}

/* Newton on the fractions and the contraction of a side together; whether it converged. */
static int solve_jointly(const struct model *m, struct wire *w, int wires, int side,
                         double stiffness_of_side, double *contraction) {
    for (int k = 0; k < NEWTON_LIMIT; k++) {
        double imbalance = -stiffness_of_side * *contraction, stiffness = stiffness_of_side;
        for (int i = 0; i < wires; i++) {
            if (w[i].side != side)
                continue;
            struct slopes r = residual(m, &w[i], *contraction, w[i].guess);
            if (r.slope <= 0.0)
                return 0;
            w[i].step = r.error / r.slope;
            w[i].coupling = r.coupling / r.slope;
            imbalance += r.stress - r.stress_slope * w[i].step;
            stiffness += r.modulus + r.stress_slope * w[i].coupling;
        }
        if (stiffness <= 0.0)
            return 0;
        double change = imbalance / stiffness, largest = fabs(change);
        *contraction += change;
        for (int i = 0; i < wires; i++) {
            if (w[i].side != side)
                continue;
            double step = w[i].step + w[i].coupling * change;
            w[i].guess = clamp(w[i].guess - step);
            if (fabs(step) > largest)
                largest = fabs(step);
        }
        if (largest < NEWTON_STEP)
            return 1;
    }
    return 0;
}

/* Sum of stresses beyond what the boundary takes, fractions solved; minus its slope to *total. */
static double side_imbalance(const struct model *m, struct wire *w, int wires, int side,
                             double stiffness, double contraction, double *total) {
    double imbalance = -stiffness * contraction;
    *total = stiffness;
    for (int i = 0; i < wires; i++) {
        if (w[i].side != side)
            continue;
        w[i].guess = solve_wire(m, &w[i], contraction);
        struct slopes r = residual(m, &w[i], contraction, w[i].guess);
        imbalance += r.stress;
        *total += r.modulus;
        if (r.slope > 0.0)
            *total += r.stress_slope * r.coupling / r.slope;
    }
    return imbalance;
}

/* Bracketed Newton on the contraction, the fractions solved within: slow and sure. */
static double solve_nested(const struct model *m, struct wire *w, int wires, int side,
                           double stiffness, double contraction) {
    double total, reach = 1e-3, low = contraction, high = contraction;
    double imbalance = side_imbalance(m, w, wires, side, stiffness, contraction, &total);
    double outward = imbalance > 0.0 ? 1.0 : -1.0;
    while (imbalance * outward > 0.0 && reach < LARGEST_STRAIN) {
        contraction += outward * reach;
        reach *= 2.0;
        imbalance = side_imbalance(m, w, wires, side, stiffness, contraction, &total);
        low = contraction < low ? contraction : low;
        high = contraction > high ? contraction : high;
    }
    for (int k = 0; k < BISECTION_LIMIT; k++) {
        if (imbalance > 0.0)
            low = contraction;
        else
            high = contraction;
        double step = total > 0.0 ? imbalance / total : LARGEST_STRAIN;
        contraction += step;
        if (fabs(step) < BRACKET)
            break;
        if (k > NEWTON_LIMIT || !(low < contraction && contraction < high)) {
            contraction = 0.5 * (low + high);
            if (high - low < BRACKET)
                break;
        }
        imbalance = side_imbalance(m, w, wires, side, stiffness, contraction, &total);
    }
    side_imbalance(m, w, wires, side, stiffness, contraction, &total);
    return contraction;
}

static void solve_side(const struct model *m, struct wire *w, int wires, struct side *s, int side) {
    double before = s->contraction, after = before + s->change;
    if (s->stiffness < 0.0) {
        for (int i = 0; i < wires; i++)
            if (w[i].side == side)
                w[i].guess = solve_wire(m, &w[i], before);
        return;
    }
    if (!solve_jointly(m, w, wires, side, s->stiffness, &after)) {
        for (int i = 0; i < wires; i++)
            if (w[i].side == side)
                w[i].guess = w[i].fraction;
        after = solve_nested(m, w, wires, side, s->stiffness, before);
    }
    s->contraction = after;
    s->change = after - before;
}

static void heat(const struct model *m, struct wire *w, double voltage, double step) {
    double steady = m->ambient + m->heating * voltage * voltage;
    double excess = w->temperature - m->ambient;
    if (m->effects > 0.0) {
        double of_phase = 1.0 + m->austenite_resistance * (1.0 - w->fraction);
        double of_heat = fmax(1.0 + m->resistance_slope * excess, LEAST);
        double loss = m->loss * fmax(1.0 + m->convection_rise * excess, LEAST);
        double exponent = -step * loss / m->capacity;
        w->decay = exp(exponent);
        w->lag = m->latent_rise * expm1(exponent) / exponent;
        steady = m->ambient + voltage * voltage / (m->resistance * of_phase * of_heat * loss);
    }
    excess = w->temperature - steady;
    if (excess * w->trend > 0.0)
        reverse(m, w, -w->trend);
    w->start = steady + excess * w->decay - w->lag * w->fraction;
    w->guess = clamp(w->fraction + w->change);
}

/* From rest; a side's stiffness below 0 clamps it. history: (3, n, wires) temperature, fraction,
 * stress; strain: (n, sides). */
void recurrence(const struct model *m, long n, int wires, int sides, const int *side_of_wire,
                const double *stiffness, const double *time, const double *voltage,
                double *history, double *strain) {
    struct wire w[MOST_WIRES] = {0};
    struct side s[MOST_WIRES] = {0};
    double last_step = 0.0;
    for (int i = 0; i < wires; i++) {
        w[i].temperature = m->ambient;
        w[i].fraction = 1.0;
        w[i].side = side_of_wire[i];
        s[w[i].side].stiffness = stiffness[w[i].side];
        reverse(m, &w[i], 1.0);
    }
    for (long k = 0; k < n; k++) {
        if (k > 0) {
            double step = time[k] - time[k - 1];
            if (step != last_step)
                for (int i = 0; i < wires; i++) {
                    double exponent = -step / m->time_constant;
                    w[i].decay = exp(exponent);
                    w[i].lag = m->latent_rise * expm1(exponent) / exponent;
                }
            last_step = step;
            for (int i = 0; i < wires; i++)
                heat(m, &w[i], voltage[(k - 1) * wires + i], step);
            for (int side = 0; side < sides; side++)
                solve_side(m, w, wires, &s[side], side);
            for (int i = 0; i < wires; i++) {
                const struct side *own = &s[w[i].side];
                double xi = w[i].guess, stretch = m->recoverable_strain * (1.0 - xi);
                w[i].temperature = w[i].start + w[i].lag * xi;
                w[i].stress = (m->austenite_modulus + xi * m->modulus_change)
                        * (stretch - own->contraction)
                    + m->expansion * (w[i].temperature - m->ambient);
                w[i].change = xi - w[i].fraction;
                w[i].fraction = xi;
            }
        }
        for (int i = 0; i < wires; i++) {
            history[k * wires + i] = w[i].temperature;
            history[(n + k) * wires + i] = w[i].fraction;
            history[(2 * n + k) * wires + i] = w[i].stress;
        }
        for (int side = 0; side < sides; side++)
            strain[k * sides + side] = s[side].contraction;
    }
}
