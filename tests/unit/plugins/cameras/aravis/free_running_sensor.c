// Preloaded into a process with aravis's own fake GigE Vision camera, which takes its frames on a grid of the
// epoch and stamps them by the host's clock: makes of it a sensor that runs freely by a crystal of its own.
//
// SENSOR_PPM    error of the crystal, in parts per million
// SENSOR_ROW_NS step that the duration of a frame is rounded to
// SENSOR_TRUTH  file that gets a line for each frame: its true start in ns of CLOCK_MONOTONIC_RAW, and its stamp
//
// Its stamps are of its own counter, in ns, with 3 us of noise (sd, as a real camera's: see the recorded ones of a
// Basler). The counter is latched by the bootstrap register of GigE Vision.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { PERIOD_US = 0x138, LATCH = 0x944, LATCHED_HIGH = 0x948, LATCHED_LOW = 0x94c };
#define NOISE_NS 3000.0
#define PAUSED_NS 500e6

typedef int (*WriteRegister)(void *camera, uint32_t address, uint32_t value);
int arv_fake_camera_read_register(void *camera, uint32_t address, uint32_t *value);

static double rate, row_ns, next_ns, start_ns;
static uint64_t stamp;
static int64_t origin_ns;
static FILE *truth;

static int64_t clock_ns(clockid_t clock) {
	struct timespec now;
	clock_gettime(clock, &now);
	return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static double setting(const char *name, double usual) {
	const char *text = getenv(name);
	return text ? atof(text) : usual;
}

static void power_on(void) {
	if (origin_ns) return;
	origin_ns = clock_ns(CLOCK_MONOTONIC_RAW);
	srand48(origin_ns ^ ((int64_t)getpid() << 32));
	rate = 1.0 + setting("SENSOR_PPM", 0.0) * 1e-6;
	row_ns = setting("SENSOR_ROW_NS", 1000.0);
	if (getenv("SENSOR_TRUTH")) truth = fopen(getenv("SENSOR_TRUTH"), "a");
}

static uint64_t counter_at(double monotonic_ns) {
	return (uint64_t)((monotonic_ns - origin_ns) * rate) + 77000000000ULL;
}

static double noise_ns(void) {
	double sum = 0;
	for (int i = 0; i < 12; i++) sum += drand48();
	return (sum - 6.0) * NOISE_NS;
}

uint64_t arv_fake_camera_get_sleep_time_for_next_frame(void *camera, uint64_t *next_real_us) {
	power_on();
	uint32_t period_us = 33333;
	arv_fake_camera_read_register(camera, PERIOD_US, &period_us);
	double now_ns = clock_ns(CLOCK_MONOTONIC_RAW), period_ns = round(period_us * 1e3 / row_ns) * row_ns;
	if (next_ns == 0 || now_ns - next_ns > PAUSED_NS) next_ns = now_ns + 20e6 + drand48() * period_ns;
	else next_ns += period_ns / rate;
	start_ns = next_ns;
	stamp = counter_at(start_ns) + (int64_t)noise_ns();
	if (truth) {
		fprintf(truth, "%.0f %llu\n", start_ns, (unsigned long long)stamp);
		fflush(truth);
	}
	double wait_us = fmax(0.0, (next_ns - now_ns) / 1e3);
	if (next_real_us) *next_real_us = clock_ns(CLOCK_REALTIME) / 1000 + (uint64_t)wait_us;
	return (uint64_t)wait_us;
}

uint64_t arv_buffer_get_timestamp(void *buffer) {
	(void)buffer;
	return stamp;
}

int arv_fake_camera_write_register(void *camera, uint32_t address, uint32_t value) {
	static WriteRegister original;
	if (!original) original = (WriteRegister)dlsym(RTLD_NEXT, "arv_fake_camera_write_register");
	if (address == LATCH && value & 2) {
		power_on();
		uint64_t counter = counter_at(clock_ns(CLOCK_MONOTONIC_RAW));
		original(camera, LATCHED_HIGH, counter >> 32);
		return original(camera, LATCHED_LOW, (uint32_t)counter);
	}
	return original(camera, address, value);
}
