// A CUDA kernel on the CPU: the threads of a block take turns at every barrier and every exchange of a warp.
// Put before the kernels' text; `kernel_text.h` is that text, and `LAUNCH(name)` is given for each kernel.
#include <algorithm>
#include <cmath>
#include <csetjmp>
#include <cstdlib>
#include <cstring>
#include <tuple>
#include <ucontext.h>
#include <utility>

using std::max;
using std::min;

#define __global__
#define __device__ static
#define __shared__ static

struct Dim { int x, y, z; };
static Dim threadIdx, blockIdx, blockDim;

namespace {
constexpr int MOST = 1024, STACK = 64 << 10;
struct Thread { jmp_buf at; ucontext_t begin; bool started, done; int exchanges; };
Thread threads[MOST];
char* stacks;
jmp_buf scheduler;
ucontext_t home;
int current, alive;
unsigned slots[2][MOST];
void (*body)(void*);
void* arguments;

void wait_for_others() {
  if (!_setjmp(threads[current].at)) _longjmp(scheduler, 1);
}

void begin() {
  body(arguments);
  threads[current].done = true;
  _longjmp(scheduler, 1);
}

void run_block(int count) {
  if (!stacks) stacks = static_cast<char*>(malloc(static_cast<size_t>(MOST) * STACK));
  for (int i = 0; i < count; i++) threads[i].started = threads[i].done = false, threads[i].exchanges = 0;
  for (alive = count; alive > 0;)
    for (int i = 0; i < count; i++) {
      Thread& one = threads[i];
      if (one.done) continue;
      current = i;
      threadIdx = {i % blockDim.x, i / blockDim.x % blockDim.y, i / blockDim.x / blockDim.y};
      if (!_setjmp(scheduler)) {
        if (one.started) _longjmp(one.at, 1);
        one.started = true;
        getcontext(&one.begin);
        one.begin.uc_stack.ss_sp = stacks + static_cast<size_t>(i) * STACK;
        one.begin.uc_stack.ss_size = STACK;
        one.begin.uc_link = nullptr;
        makecontext(&one.begin, begin, 0);
        setcontext(&one.begin);
      }
      if (threads[current].done) alive--;
    }
}

// Every lane's value, once all of the warp have given theirs.
unsigned* exchange(unsigned value) {
  unsigned* mine = slots[threads[current].exchanges++ % 2];
  mine[current] = value;
  wait_for_others();
  return mine + current / 32 * 32;
}
}  // namespace

static void __syncthreads() { wait_for_others(); }
static bool __any_sync(unsigned, bool value) {
  unsigned* all = exchange(value);
  return std::any_of(all, all + 32, [](unsigned one) { return one != 0; });
}
static int shuffled(int value, int width, int to) {
  const int lane = current % 32, first = lane / width * width;
  unsigned* all = exchange(static_cast<unsigned>(value));
  return static_cast<int>(all[to < first || to >= first + width ? lane : to]);
}
static int __shfl_xor_sync(unsigned, int value, int mask, int width) {
  return shuffled(value, width, current % 32 ^ mask);
}
static int __shfl_up_sync(unsigned, int value, int by, int width) {
  return shuffled(value, width, current % 32 - by);
}
static int __shfl_down_sync(unsigned, int value, int by, int width) {
  return shuffled(value, width, current % 32 + by);
}
static void atomicAdd(unsigned* to, unsigned value) { *to += value; }

// Arguments come as an array of pointers to them, as to CUDA's own launch.
template <typename... A, size_t... I>
static void call(void (*kernel)(A...), void** given, std::index_sequence<I...>) {
  kernel(*static_cast<A*>(given[I])...);
}
template <typename... A>
static void call_with(void (*kernel)(A...), void** given) {
  call(kernel, given, std::index_sequence_for<A...>{});
}
#define LAUNCH(kernel)                                                                    \
  extern "C" int launch_##kernel(int gx, int gy, int gz, int bx, int by, int bz, void** given) { \
    blockDim = {bx, by, bz};                                                              \
    if (bx * by * bz > MOST || bx * by * bz % 32) return 1;                               \
    body = [](void* all) { call_with(kernel, static_cast<void**>(all)); };                \
    arguments = given;                                                                    \
    for (int z = 0; z < gz; z++)                                                          \
      for (int y = 0; y < gy; y++)                                                        \
        for (int x = 0; x < gx; x++) {                                                    \
          blockIdx = {x, y, z};                                                           \
          run_block(bx * by * bz);                                                        \
        }                                                                                 \
    return 0;                                                                             \
  }

#include "kernel_text.h"

LAUNCH(costs)
LAUNCH(scan)
LAUNCH(cheapest)
