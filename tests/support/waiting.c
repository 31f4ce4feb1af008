/* What ranks that wait call again and again: on more ranks than cores they sleep for a moment instead. Linux 6.18 was seen to keep its
   own work from a core for up to 50 s while ranks yield there, so that disks stood still and tests ran out of time. */
#include <time.h>

int sched_yield(void) {
  struct timespec const moment = {0, 20000};
  return nanosleep(&moment, 0);
}
