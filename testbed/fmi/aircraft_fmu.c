/* An aircraft with its autopilot as a unit of co-simulation by FMI 2.0.

   SPDX-License-Identifier: MIT
   Copyright (c) the testbed authors

   The whole state is one block of bytes. `model.h` has the blocks of trimmed flights, where the
   variables are in a block, and the names of all. Two compiled functions act on a block:
   `testbed_place` writes the start of a flight, `testbed_fly` flies a period of the autopilot. */

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

/* Declarations of FMI 2.0.5, section 2.1.2 and after */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
  fmi2DoStepStatus,
  fmi2PendingStatus,
  fmi2LastSuccessfulTime,
  fmi2Terminated
} fmi2StatusKind;
typedef struct {
  void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
  fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* compiled: the result is not 0 for an exception, of which there is none */
extern int32_t testbed_place(int64_t *status, void **exception, void *block);
extern int32_t testbed_fly(int64_t *status, void **exception, void *block);

enum { FLYING, IMPLAUSIBLE, ABOVE_ATMOSPHERE, GROUND, STRONG_WIND, FAILED };
enum { OUTPUT, INPUT, PARAMETER };
enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED };
static const char *const REASONS[] = {
    "it flies",
    "its motion is not plausible any more",
    "it is above 20 km, where the model of the atmosphere ends",
    "it is so low that the ground may touch it",
    "the wind is too strong to fly its course over the ground",
    "a compiled function has failed",
};

typedef struct {
  char guid[sizeof GUID];
  int32_t mode;
  int32_t ended; /* why the aircraft is not flown on */
  int32_t placed; /* the block is that of the values */
  double start_time, time; /* s */
  unsigned char set[REALS]; /* before the start */
  double values[REALS];
  uint64_t block[WORDS];
} Content;

typedef struct {
  Content content;
  fmi2CallbackFunctions functions;
  char *name;
} Instance;

static fmi2Status report(const Instance *instance, fmi2Status status, const char *text) {
  if (instance->functions.logger)
    instance->functions.logger(instance->functions.componentEnvironment, instance->name, status,
                               status == fmi2Discard ? "logStatusDiscard" : "logStatusError", text);
  return status;
}

static fmi2Status refuse(const Instance *instance, const char *name, const char *text) {
  char line[1200];
  snprintf(line, sizeof line, "%s: %s", name, text);
  return report(instance, fmi2Error, line);
}

static double read_real(const Content *content, fmi2ValueReference reference) {
  double value;
  memcpy(&value, (const char *)content->block + OFFSETS[reference], sizeof value);
  return value;
}

static void write_real(Content *content, fmi2ValueReference reference, double value) {
  memcpy((char *)content->block + OFFSETS[reference], &value, sizeof value);
}

/* Returns the trimmed flight of an airspeed, the one nearest to a height; -1: there is none. */
static int find_start(double airspeed, double height) {
  int found = -1;
  for (int k = 0; k < STARTS; k++) {
    if (!(fabs(AIRSPEEDS[k] - airspeed) < 1e-6)) continue;
    if (found < 0 || fabs(HEIGHTS[k] - height) < fabs(HEIGHTS[found] - height)) found = k;
  }
  return found;
}

/* Writes the start by the values that were set. */
static fmi2Status place(Instance *instance) {
  Content *content = &instance->content;
  if (content->placed) return fmi2OK;
  double airspeed = content->set[START_AIRSPEED] ? content->values[START_AIRSPEED]
                                                 : AIRSPEEDS[DEFAULT_START];
  double height =
      content->set[START_DOWN] ? -content->values[START_DOWN] : HEIGHTS[DEFAULT_START];
  int start = find_start(airspeed, height);
  if (start < 0) {
    char line[1000];
    snprintf(line, sizeof line, "is %.15g m/s: write one of %s", airspeed, AIRSPEEDS_TEXT);
    return refuse(instance, NAMES[START_AIRSPEED], line);
  }
  memcpy(content->block, BLOCKS[start], sizeof content->block);
  for (fmi2ValueReference k = 0; k < REALS; k++)
    if (content->set[k]) write_real(content, k, content->values[k]);
  int64_t status = 0;
  void *exception = NULL;
  if (testbed_place(&status, &exception, content->block)) status = FAILED;
  if (status) return refuse(instance, "start", REASONS[status]);
  content->placed = 1;
  return fmi2OK;
}

static void begin(Content *content) {
  memset(content, 0, sizeof *content);
  memcpy(content->guid, GUID, sizeof GUID);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count,
                                      const fmi2String categories[]) {
  (void)component, (void)on, (void)count, (void)categories;
  return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                     fmi2String resources, const fmi2CallbackFunctions *functions,
                                     fmi2Boolean visible, fmi2Boolean logging) {
  (void)resources, (void)visible, (void)logging;
  Instance *instance = calloc(1, sizeof *instance);
  if (!instance) return NULL;
  if (functions) instance->functions = *functions;
  size_t length = name ? strlen(name) + 1 : 1;
  instance->name = calloc(length, 1);
  if (instance->name && name) memcpy(instance->name, name, length);
  const char *wrong = NULL;
  if (!instance->name) wrong = "there is no memory";
  else if (type != fmi2CoSimulation) wrong = "this FMU is for co-simulation only";
  else if (!guid || strcmp(guid, GUID)) wrong = "the guid is not that of modelDescription.xml";
  if (wrong) {
    report(instance, fmi2Error, wrong);
    free(instance->name);
    free(instance);
    return NULL;
  }
  begin(&instance->content);
  return instance;
}

EXPORT void fmi2FreeInstance(fmi2Component component) {
  Instance *instance = component;
  if (!instance) return;
  free(instance->name);
  free(instance);
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance,
                                      fmi2Real tolerance, fmi2Real start_time, fmi2Boolean has_stop,
                                      fmi2Real stop_time) {
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
  Content *content = &((Instance *)component)->content;
  if (content->mode != INSTANTIATED)
    return report(component, fmi2Error, "fmi2SetupExperiment is called before the initialization");
  content->start_time = content->time = start_time;
  return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
  Content *content = &((Instance *)component)->content;
  if (content->mode != INSTANTIATED)
    return report(component, fmi2Error, "the initialization has begun already");
  content->mode = INITIALISING;
  return fmi2OK;
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
  Content *content = &((Instance *)component)->content;
  if (content->mode != INITIALISING)
    return report(component, fmi2Error, "the initialization has not begun");
  fmi2Status status = place(component);
  if (status == fmi2OK) content->mode = STEPPING;
  return status;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component component) {
  ((Instance *)component)->content.mode = TERMINATED;
  return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component component) {
  begin(&((Instance *)component)->content);
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[],
                              size_t count, fmi2Real values[]) {
  Instance *instance = component;
  if (place(instance) != fmi2OK) return fmi2Error;
  for (size_t k = 0; k < count; k++) {
    if (references[k] >= REALS) return report(instance, fmi2Error, "no such real variable");
    values[k] = read_real(&instance->content, references[k]);
  }
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[],
                              size_t count, const fmi2Real values[]) {
  Instance *instance = component;
  Content *content = &instance->content;
  int begun = content->mode > INITIALISING;
  for (size_t k = 0; k < count; k++) {
    fmi2ValueReference each = references[k];
    if (each >= REALS) return report(instance, fmi2Error, "no such real variable");
    if (KINDS[each] == OUTPUT) return refuse(instance, NAMES[each], "an output cannot be set");
    if (KINDS[each] == PARAMETER && begun)
      return refuse(instance, NAMES[each], "can be set before the flight only");
    if (!isfinite(values[k])) return refuse(instance, NAMES[each], "is not a finite number");
  }
  for (size_t k = 0; k < count; k++) {
    if (begun) {
      write_real(content, references[k], values[k]);
    } else {
      content->set[references[k]] = 1;
      content->values[references[k]] = values[k];
      content->placed = 0;
    }
  }
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[],
                                 size_t count, fmi2Integer values[]) {
  Instance *instance = component;
  for (size_t k = 0; k < count; k++) {
    if (references[k] >= 1) return report(instance, fmi2Error, "no such integer variable");
    values[k] = instance->content.ended;
  }
  return fmi2OK;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component component, fmi2Real now, fmi2Real step,
                             fmi2Boolean no_return) {
  (void)no_return;
  Instance *instance = component;
  Content *content = &instance->content;
  char line[200];
  if (content->mode != STEPPING)
    return report(instance, fmi2Error, "fmi2DoStep is called after the initialization");
  if (!(fabs(now - content->time) < 1e-6)) {
    snprintf(line, sizeof line, "the step begins at %.9g s, and the flight is at %.9g s", now,
             content->time);
    return report(instance, fmi2Error, line);
  }
  double periods = nearbyint(step / PERIOD_S);
  if (!(periods >= 1.0 && periods < 1e9 && fabs(step - periods * PERIOD_S) < 1e-6)) {
    snprintf(line, sizeof line, "the step is %.9g s: write a multiple of %g s", step, PERIOD_S);
    return report(instance, fmi2Error, line);
  }
  double begin_time = content->time;
  for (int64_t k = 1; k <= (int64_t)periods && !content->ended; k++) {
    int64_t status = 0;
    void *exception = NULL;
    if (testbed_fly(&status, &exception, content->block)) status = FAILED;
    content->ended = (int32_t)status;
    content->time = begin_time + (double)k * PERIOD_S;
  }
  if (!content->ended) {
    content->time = now + step;
    return fmi2OK;
  }
  snprintf(line, sizeof line, "the flight has ended at %.9g s: %s", content->time,
           REASONS[content->ended]);
  return report(instance, fmi2Discard, line);
}

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state) {
  if (!*state) *state = malloc(sizeof(Content));
  if (!*state) return report(component, fmi2Error, "there is no memory for the state");
  memcpy(*state, &((Instance *)component)->content, sizeof(Content));
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state) {
  memcpy(&((Instance *)component)->content, state, sizeof(Content));
  return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state) {
  (void)component;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state,
                                             size_t *size) {
  (void)component, (void)state;
  *size = sizeof(Content);
  return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state,
                                        fmi2Byte bytes[], size_t size) {
  if (size < sizeof(Content)) return report(component, fmi2Error, "there are too few bytes");
  memcpy(bytes, state, sizeof(Content));
  return fmi2OK;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[],
                                          size_t size, fmi2FMUstate *state) {
  Content content;
  int known = size == sizeof content && !memcmp(bytes, GUID, sizeof GUID);
  if (known) {
    memcpy(&content, bytes, sizeof content);
    known = content.mode >= INSTANTIATED && content.mode <= TERMINATED &&
            content.ended >= FLYING && content.ended <= FAILED;
  }
  if (!known) return report(component, fmi2Error, "the bytes are no state of this FMU");
  if (!*state) *state = malloc(sizeof(Content));
  if (!*state) return report(component, fmi2Error, "there is no memory for the state");
  memcpy(*state, bytes, sizeof(Content));
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind,
                                    fmi2Real *value) {
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = ((Instance *)component)->content.time;
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind,
                                       fmi2Boolean *value) {
  if (kind != fmi2Terminated) return fmi2Discard;
  *value = ((Instance *)component)->content.ended != FLYING;
  return fmi2OK;
}

/* What this FMU has not: other types, derivatives, steps that go on beside the importer. */

#define NO_VARIABLES(name, type)                                                             \
  EXPORT fmi2Status name(fmi2Component component, const fmi2ValueReference references[],     \
                         size_t count, type values[]) {                                      \
    (void)references, (void)values;                                                          \
    return count ? report(component, fmi2Error, "there are no such variables") : fmi2OK;     \
  }
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

#define NO_STATUS(name, type)                                                                  \
  EXPORT fmi2Status name(fmi2Component component, const fmi2StatusKind kind, type *value) {    \
    (void)component, (void)kind, (void)value;                                                  \
    return fmi2Discard;                                                                        \
  }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component component,
                                               const fmi2ValueReference unknown[], size_t unknowns,
                                               const fmi2ValueReference known[], size_t knowns,
                                               const fmi2Real by[], fmi2Real derivatives[]) {
  (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)by, (void)derivatives;
  return report(component, fmi2Error, "there are no derivatives");
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component component,
                                              const fmi2ValueReference references[], size_t count,
                                              const fmi2Integer orders[],
                                              const fmi2Real values[]) {
  (void)references, (void)count, (void)orders, (void)values;
  return report(component, fmi2Error, "inputs have no derivatives");
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component,
                                               const fmi2ValueReference references[], size_t count,
                                               const fmi2Integer orders[], fmi2Real values[]) {
  (void)references, (void)count, (void)orders, (void)values;
  return report(component, fmi2Error, "outputs have no derivatives");
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component component) {
  return report(component, fmi2Error, "no step goes on");
}
