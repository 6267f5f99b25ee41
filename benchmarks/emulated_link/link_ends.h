/* The ends of an emulated link: frames as the kernel hands them over, with the time at which it had them. */

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/ethtool.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <linux/sockios.h>
#include <net/if.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { FRAME_BYTES = 1600, RECEIVE_BYTES = 4 << 20, MAX_AGE_NS = 1000000000 };

struct frame {
    int64_t due_ns;
    ssize_t bytes;
    uint8_t data[FRAME_BYTES];
};

static void fail(const char *what, const char *which)
{
    fprintf(stderr, "emulator: %s %s: %s\n", what, which, errno ? strerror(errno) : "not understood");
    exit(1);
}

static int64_t in_ns(struct timespec time)
{
    return time.tv_sec * INT64_C(1000000000) + time.tv_nsec;
}

static int64_t read_clock_ns(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return in_ns(now);
}

static int64_t now_ns(void)
{
    return read_clock_ns(CLOCK_MONOTONIC);
}

static void enter(const char *namespace, size_t length)
{
    char path[300];
    snprintf(path, sizeof path, "/run/netns/%.*s", (int)length, namespace);
    errno = 0;
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0 || setns(file, CLONE_NEWNET) < 0)
        fail("namespace", path);
    close(file);
}

/* Open this side of the cable from NODE/DEVICE. The node computes checksums and cuts segments by itself: what
   crosses must be what a wire would carry. */
static int open_end(const char *namespace, const char *where)
{
    const char *device = strrchr(where, '/');
    errno = 0;
    if (!device || strlen(device + 1) >= IFNAMSIZ)
        fail("device", where);
    enter(where, (size_t)(device - where));
    struct ethtool_value no_offload = {.cmd = ETHTOOL_STXCSUM, .data = 0};
    struct ifreq request = {.ifr_data = (char *)&no_offload};
    strcpy(request.ifr_name, device + 1);
    int node = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (node < 0 || ioctl(node, SIOCETHTOOL, &request) < 0)
        fail("checksums of", where);
    close(node);
    enter(namespace, strlen(namespace));
    int on = 1, bytes = RECEIVE_BYTES;
    int end = socket(AF_PACKET, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    struct sockaddr_ll address = {.sll_family = AF_PACKET, .sll_protocol = htons(ETH_P_ALL)};
    address.sll_ifindex = (int)if_nametoindex(device + 1);
    if (end < 0 || address.sll_ifindex == 0 || setsockopt(end, SOL_PACKET, PACKET_IGNORE_OUTGOING, &on, sizeof on) ||
        setsockopt(end, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on) ||
        setsockopt(end, SOL_SOCKET, SO_RCVBUFFORCE, &bytes, sizeof bytes) ||
        bind(end, (struct sockaddr *)&address, sizeof address))
        fail("device", where);
    return end;
}

/* Read a frame; return when the kernel had it, so that it does not matter when this process wakes up. */
static int64_t read_frame(int end, struct frame *frame)
{
    char control[CMSG_SPACE(sizeof(struct timespec))];
    struct iovec data = {frame->data, FRAME_BYTES};
    struct msghdr message = {.msg_iov = &data, .msg_iovlen = 1, .msg_control = control, .msg_controllen = sizeof control};
    frame->bytes = recvmsg(end, &message, 0);
    int64_t age_ns = 0;
    struct cmsghdr *stamp = frame->bytes > 0 ? CMSG_FIRSTHDR(&message) : NULL;
    if (stamp && stamp->cmsg_type == SO_TIMESTAMPNS) {
        struct timespec time;
        memcpy(&time, CMSG_DATA(stamp), sizeof time);
        age_ns = read_clock_ns(CLOCK_REALTIME) - in_ns(time);
    }
    return now_ns() - (age_ns > 0 && age_ns < MAX_AGE_NS ? age_ns : 0);
}
