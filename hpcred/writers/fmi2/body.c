/* A reduced body in its frame as an FMU (FMI 2.0): forces u enter, displacements, velocities and the like y leave.

       q'' = F u - K q - D q',   y = C x + E u,   x = (q, q')

   body_data.h gives m COORDINATES q, p INPUTS, r OUTPUTS, the GUID, two nominal values, and by rows, one behind the
   other, the matrices stiffness_matrix K (m, m), damping_matrix D (m, m), input_matrix F (m, p), output_matrix C (r, 2m)
   and feed_through E (r, p), in which the mass matrix is divided out already. Of a body with PARAMETERS these are the
   first of PARTS: the others are added to it, each times its factor, a function of the parameters. Value references
   count through u, y, q, v = q', dq/dt, dv/dt, and the parameters.

   Co-simulation makes no error in time but that of the inputs between communication points, which are constant, or
   linear where the master gives their derivatives: with x = (q, v) and a step h

       x(t + h) = Phi x + Gamma0 u + Gamma1 u',   Phi = exp(h A),
       Gamma0 = integral of exp((h - s) A) B ds,  Gamma1 = integral of exp((h - s) A) B s ds  from 0 to h

   The three are computed when the step size changes, by a Taylor series over h / 2^k and k doublings. */

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#include "body_data.h"

#define STATES (2 * COORDINATES)
#define TERMS 15             /* of a Taylor series with an argument of norm below 1/2: the rest is below 1e-17 */
#define SAME_STEP 1e-9       /* relative difference of step sizes below which the matrices are used again */

/* The first value reference of each kind */
enum {
    AT_INPUT = 0,
    AT_OUTPUT = AT_INPUT + INPUTS,
    AT_Q = AT_OUTPUT + OUTPUTS,
    AT_V = AT_Q + COORDINATES,
    AT_DQ = AT_V + COORDINATES,
    AT_DV = AT_DQ + COORDINATES,
    AT_PARAMETER = AT_DV + COORDINATES,
    VALUES = AT_PARAMETER + PARAMETERS
};

typedef struct {
    double stiffness_matrix[COORDINATES * COORDINATES], damping_matrix[COORDINATES * COORDINATES];
    double input_matrix[COORDINATES * INPUTS], output_matrix[OUTPUTS * STATES], feed_through[OUTPUTS * INPUTS];
} Matrices;

/* Everything that a saved state contains */
typedef struct {
    double time;
    double u[INPUTS], slope[INPUTS]; /* inputs and their derivatives */
    double x[STATES];                /* q, then v */
#if PARAMETERS
    double parameters[PARAMETERS];
#endif
} State;

typedef struct {
    State state;
    Matrices matrices;               /* at the parameters of the state */
    double step;                     /* for which the matrices are; 0 before the first step */
    double *phi, *gamma0, *gamma1;   /* (STATES, STATES), (STATES, INPUTS) twice */
    char *name;
    const fmi2CallbackFunctions *callbacks;
} Instance;


/* ---- The equations of motion ---- */

static double dot(const double *row, const double *column, int count)
{
    double sum = 0.0;
    int i;
    for (i = 0; i < count; i++)
        sum += row[i] * column[i];
    return sum;
}

static double acceleration(const Matrices *m, const State *state, int i)
{
    return dot(m->input_matrix + i * INPUTS, state->u, INPUTS)
         - dot(m->stiffness_matrix + (size_t)i * COORDINATES, state->x, COORDINATES)
         - dot(m->damping_matrix + (size_t)i * COORDINATES, state->x + COORDINATES, COORDINATES);
}

static double value_of(const Matrices *m, const State *state, int reference)
{
    const int row = reference - AT_OUTPUT;
    if (reference < AT_OUTPUT)
        return state->u[reference];
    if (reference < AT_Q)
        return dot(m->output_matrix + (size_t)row * STATES, state->x, STATES)
             + dot(m->feed_through + (size_t)row * INPUTS, state->u, INPUTS);
    if (reference < AT_DQ)
        return state->x[reference - AT_Q];
    if (reference < AT_DV)
        return state->x[COORDINATES + reference - AT_DQ];
#if PARAMETERS
    if (reference >= AT_PARAMETER)
        return state->parameters[reference - AT_PARAMETER];
#endif
    return acceleration(m, state, reference - AT_DV);
}

/* Where an input or a state is kept; NULL for what is calculated */
static double *place_of(State *state, fmi2ValueReference reference)
{
    if (reference < AT_OUTPUT)
        return state->u + reference;
    if (reference >= AT_Q && reference < AT_DQ)
        return state->x + (reference - AT_Q);
#if PARAMETERS
    if (reference >= AT_PARAMETER && reference < VALUES)
        return state->parameters + (reference - AT_PARAMETER);
#endif
    return NULL;
}

/* Make the matrices at the parameters of the state; 0 where a factor is no finite number */
static int update(Instance *self)
{
    memcpy(&self->matrices, parts[0], sizeof(Matrices));
    self->step = 0.0;
#if PARAMETERS
    double theta[PARTS], *entries = (double *)&self->matrices;
    size_t i, k;
    factors(self->state.parameters, theta);
    for (k = 1; k < PARTS; k++) {
        if (!isfinite(theta[k]))
            return 0;
        for (i = 0; i < ENTRIES; i++)
            entries[i] += theta[k] * parts[k][i];
    }
#endif
    return 1;
}

/* The state at the start */
static int begin(Instance *self)
{
    memset(&self->state, 0, sizeof(State));
#if PARAMETERS
    memcpy(self->state.parameters, reference_values, sizeof(reference_values));
#endif
    return update(self);
}


/* ---- One step of co-simulation ---- */

/* out = a b with a (rows, inner), b (inner, columns). Zeros of a are skipped: modes that are not coupled cost little. */
static void multiply(double *out, const double *a, const double *b, int rows, int inner, int columns)
{
    int i, j, k;
    memset(out, 0, sizeof(double) * rows * columns);
    for (i = 0; i < rows; i++)
        for (k = 0; k < inner; k++) {
            const double factor = a[(size_t)i * inner + k];
            const double *row = b + (size_t)k * columns;
            double *target = out + (size_t)i * columns;
            if (factor != 0.0)
                for (j = 0; j < columns; j++)
                    target[j] += factor * row[j];
        }
}

/* A for the states (scale q, v), in which both halves have the same size; returns its norm: the largest column sum */
static double system_matrix(const Matrices *m, double *a, double scale)
{
    double largest = 0.0;
    int i, j;
    memset(a, 0, sizeof(double) * STATES * STATES);
    for (i = 0; i < COORDINATES; i++) {
        double *upper = a + (size_t)i * STATES, *lower = a + (size_t)(COORDINATES + i) * STATES;
        upper[COORDINATES + i] = scale;
        for (j = 0; j < COORDINATES; j++) {
            lower[j] = -m->stiffness_matrix[(size_t)i * COORDINATES + j] / scale;
            lower[COORDINATES + j] = -m->damping_matrix[(size_t)i * COORDINATES + j];
        }
    }
    for (j = 0; j < STATES; j++) {
        double sum = 0.0;
        for (i = 0; i < STATES; i++)
            sum += fabs(a[(size_t)i * STATES + j]);
        largest = sum > largest ? sum : largest;
    }
    return largest;
}

/* The root of the norm of K: a circular frequency, the highest one where K is diagonal */
static double highest_frequency(const Matrices *m)
{
    double largest = 0.0;
    int i, j;
    for (i = 0; i < COORDINATES; i++) {
        double sum = 0.0;
        for (j = 0; j < COORDINATES; j++)
            sum += fabs(m->stiffness_matrix[(size_t)i * COORDINATES + j]);
        largest = sum > largest ? sum : largest;
    }
    return largest > 0.0 ? sqrt(largest) : 1.0;
}

/* Phi, Gamma0 and Gamma1 of a step; 0 where memory is missing */
static int prepare(Instance *self, double step)
{
    const Matrices *m = &self->matrices;
    const size_t square = (size_t)STATES * STATES, tall = (size_t)STATES * INPUTS;
    double *memory = malloc(sizeof(double) * (3 * square + 2 * tall)), *swap;
    double *a = memory, *term = a + square, *work = term + square, *load = work + square, *next = load + tall;
    double *phi = self->phi, *gamma0 = self->gamma0, *gamma1 = self->gamma1;
    double scale = highest_frequency(m), small, factor;
    int doublings = 0, k;
    size_t i;
    if (memory == NULL)
        return 0;
    for (factor = system_matrix(m, a, scale) * step; factor > 0.5; factor /= 2)
        doublings++;
    small = ldexp(step, -doublings);
    for (i = 0; i < square; i++)
        a[i] *= small;

    /* exp(Z) = sum Z^k / k!, and of the loads B the same with (k + 1)! and (k + 2)! */
    memset(term, 0, sizeof(double) * square);
    for (i = 0; i < STATES; i++)
        term[i * STATES + i] = 1.0;
    memcpy(phi, term, sizeof(double) * square);
    memset(load, 0, sizeof(double) * tall);
    memcpy(load + (size_t)COORDINATES * INPUTS, m->input_matrix, sizeof(m->input_matrix));
    for (i = 0; i < tall; i++) {
        gamma0[i] = small * load[i];
        gamma1[i] = small * small * load[i] / 2;
    }
    for (k = 1; k < TERMS; k++) {
        multiply(work, a, term, STATES, STATES, STATES);
        swap = term, term = work, work = swap;
        multiply(next, a, load, STATES, STATES, INPUTS);
        swap = load, load = next, next = swap;
        for (i = 0; i < square; i++)
            phi[i] += term[i] /= k;
        for (i = 0; i < tall; i++) {
            load[i] /= k;
            gamma0[i] += small * load[i] / (k + 1);
            gamma1[i] += small * small * load[i] / ((k + 1.0) * (k + 2.0));
        }
    }

    /* two steps after each other are one of twice the length */
    for (; doublings > 0; doublings--, small *= 2) {
        multiply(next, phi, gamma1, STATES, STATES, INPUTS);
        for (i = 0; i < tall; i++)
            gamma1[i] += next[i] + small * gamma0[i];
        multiply(next, phi, gamma0, STATES, STATES, INPUTS);
        for (i = 0; i < tall; i++)
            gamma0[i] += next[i];
        multiply(work, phi, phi, STATES, STATES, STATES);
        memcpy(phi, work, sizeof(double) * square);
    }

    /* back to the states (q, v) */
    for (i = 0; i < square; i++) {
        const int row_is_q = i / STATES < COORDINATES, column_is_q = i % STATES < COORDINATES;
        if (row_is_q && !column_is_q)
            phi[i] /= scale;
        if (!row_is_q && column_is_q)
            phi[i] *= scale;
    }
    for (i = 0; i < tall / 2; i++) {
        gamma0[i] /= scale;
        gamma1[i] /= scale;
    }
    free(memory);
    self->step = step;
    return 1;
}

static void advance(Instance *self, double step)
{
    State *state = &self->state;
    const double rest = step - self->step; /* nothing but round-off of the master's clock */
    double x[STATES];
    int i;
    for (i = 0; i < STATES; i++)
        x[i] = dot(self->phi + (size_t)i * STATES, state->x, STATES)
             + dot(self->gamma0 + (size_t)i * INPUTS, state->u, INPUTS)
             + dot(self->gamma1 + (size_t)i * INPUTS, state->slope, INPUTS);
    memcpy(state->x, x, sizeof(x));
    for (i = 0; i < INPUTS; i++)
        state->u[i] += step * state->slope[i];
    for (i = 0; i < COORDINATES; i++) {
        x[i] = state->x[i] + rest * state->x[COORDINATES + i];
        x[COORDINATES + i] = state->x[COORDINATES + i] + rest * acceleration(&self->matrices, state, i);
    }
    memcpy(state->x, x, sizeof(x));
}


/* ---- FMI: instances ---- */

static fmi2Status failed(Instance *self, const char *message)
{
    const fmi2CallbackFunctions *callbacks = self->callbacks;
    if (callbacks != NULL && callbacks->logger != NULL)
        callbacks->logger(callbacks->componentEnvironment, self->name, fmi2Error, "logStatusError", message);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (self == NULL)
        return;
    free(self->phi);
    free(self->gamma0);
    free(self->gamma1);
    free(self->name);
    free(self);
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *self = calloc(1, sizeof(Instance));
    (void)resources, (void)visible, (void)logging;
    if (self == NULL)
        return NULL;
    self->callbacks = callbacks;
    self->name = malloc(strlen(name) + 1);
    if (self->name != NULL)
        strcpy(self->name, name);
    if (type == fmi2CoSimulation) {
        self->phi = malloc(sizeof(double) * STATES * STATES);
        self->gamma0 = malloc(sizeof(double) * STATES * INPUTS);
        self->gamma1 = malloc(sizeof(double) * STATES * INPUTS);
    }
    if (self->name == NULL || (type == fmi2CoSimulation && !(self->phi && self->gamma0 && self->gamma1)))
        failed(self, "there is not enough memory for the body");
    else if (guid == NULL || strcmp(guid, GUID) != 0)
        failed(self, "the guid is not that of this FMU: modelDescription.xml and the binary do not belong together");
    else if (!begin(self))
        failed(self, "the factors of the terms are no finite numbers at the reference values");
    else
        return self;
    fmi2FreeInstance(self);
    return NULL;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Instance *)c)->state.time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    begin(c);
    return fmi2OK;
}


/* ---- FMI: values ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    Instance *self = c;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] >= VALUES)
            return failed(self, "fmi2GetReal: no variable has this value reference");
        values[i] = value_of(&self->matrices, &self->state, (int)references[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2Real values[])
{
    Instance *self = c;
    size_t i;
    int changed = 0;
    for (i = 0; i < count; i++) {
        double *place = place_of(&self->state, references[i]);
        if (place == NULL)
            return failed(self, "fmi2SetReal: only inputs, and q, v and parameters before the start, can be set");
        if (!isfinite(values[i]))
            return failed(self, "fmi2SetReal: found a value that is NaN or infinite");
#if PARAMETERS
        if (references[i] >= AT_PARAMETER) {
            const int k = references[i] - AT_PARAMETER;
            if (values[i] < lowest_values[k] || values[i] > highest_values[k])
                return failed(self, "fmi2SetReal: found a value of a parameter outside of its range (min, max)");
            changed = changed || *place != values[i];
        }
#endif
        *place = values[i];
        if (references[i] < AT_OUTPUT)
            self->state.slope[references[i]] = 0.0;
    }
    if (changed && !update(self))
        return failed(self, "fmi2SetReal: the factors of the terms are no finite numbers at these parameters");
    return fmi2OK;
}

/* There are no variables of other types. */
static fmi2Status none(fmi2Component c, size_t count)
{
    return count == 0 ? fmi2OK : failed(c, "all variables of this FMU are real");
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Integer values[])
{
    (void)references, (void)values;
    return none(c, count);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Boolean values[])
{
    (void)references, (void)values;
    return none(c, count);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2String values[])
{
    (void)references, (void)values;
    return none(c, count);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference references[], size_t count,
                          const fmi2Integer values[])
{
    (void)references, (void)values;
    return none(c, count);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t count,
                          const fmi2Boolean values[])
{
    (void)references, (void)values;
    return none(c, count);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference references[], size_t count,
                         const fmi2String values[])
{
    (void)references, (void)values;
    return none(c, count);
}

/* The equations are linear without a constant, so that a derivative is their value at the given changes alone. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real changes[],
                                        fmi2Real derivatives[])
{
    Instance *self = c;
    State change;
    size_t i;
    memset(&change, 0, sizeof(change));
    for (i = 0; i < knowns; i++) {
        double *place = place_of(&change, known[i]);
        if (place == NULL || known[i] >= AT_PARAMETER)
            return failed(self, "fmi2GetDirectionalDerivative: only inputs and states are known");
        *place = changes[i];
    }
    for (i = 0; i < unknowns; i++) {
        if (unknown[i] >= VALUES)
            return failed(self, "fmi2GetDirectionalDerivative: no variable has this value reference");
        derivatives[i] = value_of(&self->matrices, &change, (int)unknown[i]);
    }
    return fmi2OK;
}


/* ---- FMI: saved states ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    Instance *self = c;
    if (*saved == NULL)
        *saved = malloc(sizeof(State));
    if (*saved == NULL)
        return failed(self, "there is not enough memory to save a state");
    memcpy(*saved, &self->state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    Instance *self = c;
#if PARAMETERS
    const int same = memcmp(self->state.parameters, ((State *)saved)->parameters, sizeof(reference_values)) == 0;
#else
    const int same = 1;
#endif
    memcpy(&self->state, saved, sizeof(State));
    if (!same && !update(self))
        return failed(self, "fmi2SetFMUstate: the factors of the terms are no finite numbers at its parameters");
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    (void)c, (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(State))
        return failed(c, "fmi2SerializeFMUstate: the state needs more bytes");
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (size != sizeof(State))
        return failed(c, "fmi2DeSerializeFMUstate: these bytes are no state of this FMU");
    if (*saved == NULL)
        *saved = malloc(sizeof(State));
    if (*saved == NULL)
        return failed(c, "there is not enough memory to save a state");
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}


/* ---- FMI: model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)c;
    memset(info, 0, sizeof(*info));
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate)
{
    (void)c, (void)no_set_state;
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ((Instance *)c)->state.time = time;
    return fmi2OK;
}

static fmi2Status check_count(Instance *self, size_t count, size_t expected)
{
    return count == expected ? fmi2OK : failed(self, "the number of states or event indicators is not that of this FMU");
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t count)
{
    Instance *self = c;
    size_t i;
    if (check_count(self, count, STATES) != fmi2OK)
        return fmi2Error;
    for (i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return failed(self, "fmi2SetContinuousStates: found a state that is NaN or infinite");
    memcpy(self->state.x, x, sizeof(self->state.x));
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t count)
{
    Instance *self = c;
    if (check_count(self, count, STATES) != fmi2OK)
        return fmi2Error;
    memcpy(x, self->state.x, sizeof(self->state.x));
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t count)
{
    Instance *self = c;
    int i;
    if (check_count(self, count, STATES) != fmi2OK)
        return fmi2Error;
    for (i = 0; i < STATES; i++)
        derivatives[i] = value_of(&self->matrices, &self->state, AT_DQ + i);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t count)
{
    int i;
    if (check_count(c, count, STATES) != fmi2OK)
        return fmi2Error;
    for (i = 0; i < STATES; i++)
        nominals[i] = i < COORDINATES ? NOMINAL_Q : NOMINAL_V;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t count)
{
    (void)indicators;
    return check_count(c, count, 0);
}


/* ---- FMI: co-simulation ---- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t count,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
    Instance *self = c;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] >= AT_OUTPUT || orders[i] != 1)
            return failed(self, "fmi2SetRealInputDerivatives: only the first derivatives of inputs can be set");
        if (!isfinite(values[i]))
            return failed(self, "fmi2SetRealInputDerivatives: found a value that is NaN or infinite");
        self->state.slope[references[i]] = values[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t count,
                                        const fmi2Integer orders[], fmi2Real values[])
{
    (void)references, (void)count, (void)orders, (void)values;
    return failed(c, "fmi2GetRealOutputDerivatives: take the velocities and the derivatives of the states");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state)
{
    Instance *self = c;
    (void)no_set_state;
    if (!(step >= 0.0 && step <= DBL_MAX))
        return failed(self, "fmi2DoStep: the step size must be finite and not negative");
    if (step > 0.0) {
        if (fabs(step - self->step) > SAME_STEP * step && !prepare(self, step))
            return failed(self, "there is not enough memory for a step");
        advance(self, step);
    }
    self->state.time = time + step;
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return failed(c, "fmi2CancelStep: no step is pending");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Instance *)c)->state.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
