/* The law of scenarios/leader_follower.py as an FMU, of FMI 2.0, or of 3.0 with arrays (-DFMI3).
 *
 * A fault may be planted: -DLEFT_OUT (an integral is not in the serialised state), -DSHARED (it is
 * one of all instances), -DNO_RESET (the reset function leaves it), -DCRASH_S=5.0 (writes to address
 * 0 in a later step), -DCRASH_AT_ONCE (the same when an instance is made), -DFAIL_S=5.0 (an error),
 * -DNOT_FINITE_S=5.0 (an output that is no number), -DGROWS_S=5.0 (the state becomes larger).
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX_N 4

typedef struct {
  double now, own_position[3], own_velocity[3];
  double received[MAX_N], position[3 * MAX_N], velocity[3 * MAX_N], rates[3 * MAX_N];
  double slot[3], speed_min, speed_max, trim_throttle, leader_timeout, dt;
  double closing, field, approach, pitch, roll, throttle;
  double sum_speed, sum_climb;
  bool failed[MAX_N];
  uint32_t n;  // with the above 64 words: the state needs no other kernel than that of none
} Law;

static double shared_speed;

static double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static const Law START = {
    .closing = 0.3, .field = 0.03, .approach = 1.0471975511965976, .n = 4, .dt = 0.04};

static int step(Law *s) {
  const double pi = 3.141592653589793;
#ifdef SHARED
  s->sum_speed = shared_speed;
#endif
#ifdef CRASH_S
  if (s->now > CRASH_S) *(volatile int *)0 = 1;
#endif
#ifdef FAIL_S
  if (s->now > FAIL_S) return 3;
#endif
  double age = s->now - s->received[0], velocity[3], offset[3];
  const bool timeout = !(age <= s->leader_timeout);
  if (timeout) age = 0.0;
  for (int k = 0; k < 3; k++) {
    velocity[k] = timeout ? s->own_velocity[k] : s->velocity[k];
    offset[k] = s->position[k] + age * velocity[k] - s->own_position[k];
  }
  const double turn = timeout ? 0.0 : s->rates[2];
  const double level = hypot(velocity[0], velocity[1]);
  const double north = velocity[0] / level, east = velocity[1] / level;
  const double along = offset[0] * north + offset[1] * east + s->slot[0];
  const double across = -offset[0] * east + offset[1] * north + s->slot[1];
  const double slot_speed = level - turn * s->slot[1];
  const double slot_course = atan2(velocity[1], velocity[0]) + turn * s->slot[0] / slot_speed;
  const double ground = hypot(s->own_velocity[0], s->own_velocity[1]);
  const double command = clip(slot_speed + s->closing * along, s->speed_min, s->speed_max);
  const double speed_error = timeout ? 0.0 : command - ground;
  const double bearing = slot_course + s->approach * (2.0 / pi) * atan(s->field * across);
  double course = bearing - atan2(s->own_velocity[1], s->own_velocity[0]) + pi;
  course = fmod(course, 2.0 * pi);
  if (course < 0.0) course += 2.0 * pi;
  course -= pi;
  const double height_error = timeout ? 0.0 : offset[2] + s->slot[2];
  s->throttle = s->trim_throttle + 0.12 * speed_error + 0.02 * s->sum_speed;
  s->pitch = timeout ? 0.0 : -velocity[2] / level - 0.02 * height_error - 0.001 * s->sum_climb;
  s->roll = timeout ? 0.0 : atan(turn * ground / 9.81) + 2.5 * course;
  s->sum_speed = clip(s->sum_speed + s->dt * speed_error, -10.0, 10.0);
  s->sum_climb = clip(s->sum_climb + s->dt * height_error, -100.0, 100.0);
  shared_speed = s->sum_speed;
#ifdef NOT_FINITE_S
  if (s->now > NOT_FINITE_S) s->roll = NAN;
#endif
  return 0;
}

static void *make(const char *token) {
  if (!token || strcmp(token, "{1b0e6c1e-leader-follower}")) return NULL;
#ifdef CRASH_AT_ONCE
  *(volatile int *)0 = 1;
#endif
  Law *law = malloc(sizeof *law);
  if (law) *law = START;
  return law;
}

static int reset(Law *law) {
#ifdef NO_RESET
  const double sum = law->sum_speed;
  *law = START;
  law->sum_speed = sum;
#else
  *law = START;
#endif
  return 0;
}

typedef struct {
  double *at;
  size_t size;
} Slice;

/* The numbers of a value reference: of FMI 2.0 one, behind 100 times that of the array. */
static Slice slice(Law *s, unsigned reference) {
#ifdef FMI3
  const size_t n = s->n;
  const unsigned r = reference;
#else
  const size_t n = MAX_N;
  const unsigned r = reference / 100;
#endif
  Slice found = {NULL, 0};
  switch (r) {
    case 1: found = (Slice){&s->now, 1}; break;
    case 2: found = (Slice){s->own_position, 3}; break;
    case 3: found = (Slice){s->own_velocity, 3}; break;
    case 4: found = (Slice){s->received, n}; break;
    case 5: found = (Slice){s->position, 3 * n}; break;
    case 6: found = (Slice){s->velocity, 3 * n}; break;
    case 7: found = (Slice){s->rates, 3 * n}; break;
    case 8: found = (Slice){s->slot, 3}; break;
    case 9: found = (Slice){&s->speed_min, 1}; break;
    case 10: found = (Slice){&s->speed_max, 1}; break;
    case 11: found = (Slice){&s->trim_throttle, 1}; break;
    case 12: found = (Slice){&s->leader_timeout, 1}; break;
    case 13: found = (Slice){&s->dt, 1}; break;
    case 14: found = (Slice){&s->closing, 1}; break;
    case 15: found = (Slice){&s->field, 1}; break;
    case 16: found = (Slice){&s->pitch, 1}; break;
    case 17: found = (Slice){&s->roll, 1}; break;
    case 18: found = (Slice){&s->throttle, 1}; break;
  }
#ifndef FMI3
  if (found.at) found = (Slice){found.at + reference % 100, 1};
#endif
  return found;
}

static int copy(Law *s, const unsigned r[], size_t n, double *values, bool set) {
  size_t at = 0;
  for (size_t k = 0; k < n; k++) {
    const Slice each = slice(s, r[k]);
    if (!each.at) return 3;
    if (set) memcpy(each.at, values + at, 8 * each.size);
    else memcpy(values + at, each.at, 8 * each.size);
    at += each.size;
  }
  return 0;
}

static int get_state(void *c, void **state) {
  if (!*state) *state = malloc(sizeof(Law));
  if (!*state) return 3;
  memcpy(*state, c, sizeof(Law));
  return 0;
}
static int set_state(void *c, void *state) {
#ifdef LEFT_OUT
  const double sum = ((Law *)c)->sum_speed;
  memcpy(c, state, sizeof(Law));
  ((Law *)c)->sum_speed = sum;
#else
  memcpy(c, state, sizeof(Law));
#endif
  return 0;
}
static int free_state(void **state) {
  free(*state);
  *state = NULL;
  return 0;
}
static int size_of_state(void *state, size_t *size) {
  *size = sizeof(Law);
#ifdef GROWS_S
  if (((Law *)state)->now > GROWS_S) *size += 8;
#endif
  return (void)state, 0;
}
static int serialise(void *state, void *bytes, size_t size) {
  if (size < sizeof(Law)) return 3;
  memcpy(bytes, state, sizeof(Law));
  return 0;
}
static int deserialise(void *c, const void *bytes, size_t size, void **state) {
  if (size < sizeof(Law) || get_state(c, state)) return 3;
  memcpy(*state, bytes, sizeof(Law));
  return 0;
}

#ifdef FMI3
#define F(name) fmi3##name
#define STATE(verb) fmi3##verb##FMUState
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  bool visible, bool logging, bool events, bool early,
                                  const unsigned r[], size_t n, void *environment, void *log,
                                  void *update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
  (void)r, (void)n, (void)environment, (void)log, (void)update;
  return make(token);
}
int fmi3EnterConfigurationMode(void *c) { return (void)c, 0; }
int fmi3ExitConfigurationMode(void *c) { return (void)c, 0; }
int fmi3EnterInitializationMode(void *c, bool tolerant, double tolerance, double start, bool ends,
                                double stop) {
  (void)c, (void)tolerant, (void)tolerance, (void)start, (void)ends, (void)stop;
  return 0;
}
int fmi3SetUInt64(void *c, const unsigned r[], size_t n, const uint64_t v[], size_t m) {
  if (n != 1 || m != 1 || r[0] != 20 || v[0] < 1 || v[0] > MAX_N) return 3;
  ((Law *)c)->n = v[0];
  return 0;
}
int fmi3SetFloat64(void *c, const unsigned r[], size_t n, const double v[], size_t m) {
  return (void)m, copy(c, r, n, (double *)v, true);
}
int fmi3GetFloat64(void *c, const unsigned r[], size_t n, double v[], size_t m) {
  return (void)m, copy(c, r, n, v, false);
}
int fmi3SetBoolean(void *c, const unsigned r[], size_t n, const bool v[], size_t m) {
  if (n != 1 || r[0] != 19 || m != ((Law *)c)->n) return 3;
  memcpy(((Law *)c)->failed, v, m);
  return 0;
}
int fmi3DoStep(void *c, double time, double size, bool keeps, bool *event, bool *ends, bool *early,
               double *last) {
  (void)keeps;
  *event = *ends = *early = false;
  *last = time + size;
  return step(c);
}
int fmi3DeserializeFMUState(void *c, const uint8_t b[], size_t n, void **state) {
  return deserialise(c, b, n, state);
}
#else
#define F(name) fmi2##name
#define STATE(verb) fmi2##verb##FMUstate
void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                      const void *callbacks, int visible, int logging) {
  (void)name, (void)type, (void)resources, (void)callbacks, (void)visible, (void)logging;
  return make(guid);
}
int fmi2SetupExperiment(void *c, int tolerant, double tolerance, double start, int ends,
                        double stop) {
  (void)c, (void)tolerant, (void)tolerance, (void)start, (void)ends, (void)stop;
  return 0;
}
int fmi2EnterInitializationMode(void *c) { return (void)c, 0; }
int fmi2SetReal(void *c, const unsigned r[], size_t n, const double v[]) {
  return copy(c, r, n, (double *)v, true);
}
int fmi2GetReal(void *c, const unsigned r[], size_t n, double v[]) {
  return copy(c, r, n, v, false);
}
int fmi2SetBoolean(void *c, const unsigned r[], size_t n, const int v[]) {
  for (size_t k = 0; k < n; k++) ((Law *)c)->failed[r[k] % 100] = v[k];
  return 0;
}
int fmi2DoStep(void *c, double time, double size, int keeps) {
  (void)time, (void)size, (void)keeps;
  return step(c);
}
int fmi2DeSerializeFMUstate(void *c, const char b[], size_t n, void **state) {
  return deserialise(c, b, n, state);
}
#endif

void F(FreeInstance)(void *c) { free(c); }
int F(ExitInitializationMode)(void *c) { return (void)c, 0; }
int F(Reset)(void *c) { return reset(c); }
int STATE(Get)(void *c, void **state) { return get_state(c, state); }
int STATE(Set)(void *c, void *state) { return set_state(c, state); }
int STATE(Free)(void *c, void **state) { return (void)c, free_state(state); }
int STATE(Serialize)(void *c, void *state, void *b, size_t n) {
  return (void)c, serialise(state, b, n);
}
#ifdef FMI3
int fmi3SerializedFMUStateSize(void *c, void *state, size_t *n) {
  return (void)c, size_of_state(state, n);
}
#else
int fmi2SerializedFMUstateSize(void *c, void *state, size_t *n) {
  return (void)c, size_of_state(state, n);
}
#endif
