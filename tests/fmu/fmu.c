/* An impedance controller as FMU; FMI is 2 or 3. Values: 0 stiffness, 1 damping, 10.. inputs, 100.. outputs. */
#include <stdlib.h>
#include <string.h>
#define N 7
typedef struct { double k[2], in[4 * N], out[N]; int terminated; } Model;
static double *at(Model *m, unsigned ref) {
    return ref < 2 ? &m->k[ref] : ref >= 10 && ref < 10 + 4 * N ? &m->in[ref - 10] : ref >= 100 && ref < 100 + N ? &m->out[ref - 100] : NULL;
}
static void law(Model *m) {
    for (int i = 0; i < N; i++) m->out[i] = m->k[0] * (m->in[2 * N + i] - m->in[i]) - m->k[1] * m->in[N + i] + m->in[3 * N + i];
}
static Model *make(void) { Model *m = calloc(1, sizeof *m); m->k[0] = 800; m->k[1] = 40; return m; }
#if FMI == 2
#include "fmi2Functions.h"
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean v, fmi2Boolean l) {
    if (strcmp(g, "{sero-1}")) { f->logger(f->componentEnvironment, n, fmi2Error, "error", "wrong guid"); return NULL; }
    return make(); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean b, size_t n, const fmi2String s[]) { return fmi2OK; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return getenv("FMU_FAIL") ? fmi2Error : fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { law(c); return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) { for (size_t i = 0; i < n; i++) { double *p = at(c, r[i]); if (!p) return fmi2Error; v[i] = *p; } return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) { for (size_t i = 0; i < n; i++) { double *p = at(c, r[i]); if (!p) return fmi2Error; *p = v[i]; } return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) { if (getenv("FMU_STEP_FAIL") && t > 0.05) return fmi2Error; law(c); return fmi2OK; }
#define BAD(name, ...) fmi2Status name(__VA_ARGS__) { return fmi2Error; }
BAD(fmi2GetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
BAD(fmi2GetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
BAD(fmi2GetString, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
BAD(fmi2SetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
BAD(fmi2SetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
BAD(fmi2SetString, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
BAD(fmi2CancelStep, fmi2Component c)
BAD(fmi2GetStatus, fmi2Component c, const fmi2StatusKind k, fmi2Status *v)
BAD(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind k, fmi2Real *v)
BAD(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind k, fmi2Integer *v)
BAD(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v)
BAD(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind k, fmi2String *v)
BAD(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *s)
BAD(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate s)
BAD(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *s)
BAD(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
BAD(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
BAD(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
BAD(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference u[], size_t n, const fmi2ValueReference k[], size_t m, const fmi2Real d[], fmi2Real e[])
BAD(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[], const fmi2Real v[])
BAD(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[], fmi2Real v[])
#else
#include "fmi3Functions.h"
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String g, fmi3String r, fmi3Boolean v, fmi3Boolean l, fmi3Boolean e, fmi3Boolean er, const fmi3ValueReference q[], size_t nq, fmi3InstanceEnvironment env, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback iu) { return strcmp(g, "{sero-1}") ? NULL : make(); }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean b, size_t n, const fmi3String s[]) { return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 d, fmi3Boolean e, fmi3Float64 f) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { law(c); return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return fmi3OK; }
static fmi3Status move(Model *m, const unsigned *r, size_t n, double *v, size_t nv, int set) {
    size_t k = 0;
    for (size_t i = 0; i < n; i++) { size_t width = r[i] < 2 ? 1 : N; double *p = at(m, r[i]); if (!p || k + width > nv) return fmi3Error;
        if (set) memcpy(p, v + k, 8 * width); else memcpy(v + k, p, 8 * width); k += width; }
    return k == nv ? fmi3OK : fmi3Error; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t nv) { return move(c, r, n, v, nv, 0); }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t nv) { return move(c, r, n, (double *)v, nv, 1); }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean x, fmi3Boolean *e, fmi3Boolean *te, fmi3Boolean *er, fmi3Float64 *last) { law(c); *e = *te = *er = 0; *last = t + h; return fmi3OK; }
#endif
