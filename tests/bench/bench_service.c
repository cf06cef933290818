// SPDX-License-Identifier: Apache-2.0
// bench_service.c - airyd as a service, measured: STATUS and small jobs beside a farm's range, idle connections held, kill -9 to the next
// frame, memory over small frames, the lines of a Python client. `make bench-service`; --help.
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "bench_service.h"

static const char usage[] =
    "Usage: bench_service [OPTION]... [PART]...\n"
    "Measures airyd as a service. PART: load, held, kill, memory, python; all when none is named.\n\n"
    "      --airyd FILE, --airy FILE   the programs (default build/airyd, build/airy)\n"
    "      --readme FILE               of the Python client (default client/python/README.md)\n"
    "      --seconds S                 of each measurement under load (default 6)\n"
    "      --rounds N                  of the measurements under load, 1 to 16 (default 3)\n"
    "      --users N                   of the crowd, 1 to 64 (default 8)\n"
    "      --connections N             to be held, 1 to 65000 (default 10000)\n"
    "      --kills N                   rounds of kill -9, 1 to 1000 (default 20)\n"
    "      --frames N                  small ones, 100 to 1000000000 (default 100000)\n"
    "      --flight N                  of those in flight, 1 to 64 (default 32)\n"
    "AIRY_BENCH_VERBOSE in the environment: what airyd prints is seen.\n";

enum part { PART_LOAD = 1, PART_HELD = 2, PART_KILL = 4, PART_MEMORY = 8, PART_PYTHON = 16, PART_ALL = 31 };
enum option_id { OPT_AIRYD = 1, OPT_AIRY, OPT_README, OPT_SECONDS, OPT_ROUNDS, OPT_USERS, OPT_CONNECTIONS, OPT_KILLS, OPT_FRAMES, OPT_FLIGHT, OPT_HELP };

static double number(const char *name, const char *text, double min, double max)
{
    char *end;
    double v = strtod(text, &end);
    if (end == text || *end || !(v >= min && v <= max))
        die("--%s: \"%s\"; expected a number from %g to %g", name, text, min, max);
    return v;
}

static void take_option(struct service_options *o, int id, const char *arg)
{
    switch (id) {
    case OPT_AIRYD: o->airyd = arg; break;
    case OPT_AIRY: o->airy = arg; break;
    case OPT_README: o->readme = arg; break;
    case OPT_SECONDS: o->seconds = number("seconds", arg, .1, 3600); break;
    case OPT_ROUNDS: o->rounds = (unsigned)number("rounds", arg, 1, 16); break;
    case OPT_USERS: o->users = (unsigned)number("users", arg, 1, 64); break;
    case OPT_CONNECTIONS: o->connections = (unsigned)number("connections", arg, 1, 65000); break;
    case OPT_KILLS: o->kills = (unsigned)number("kills", arg, 1, 1000); break;
    case OPT_FRAMES: o->frames = (uint64_t)number("frames", arg, 100, 1e9); break;
    case OPT_FLIGHT: o->flight = (unsigned)number("flight", arg, 1, 64); break;
    case OPT_HELP: fputs(usage, stdout); exit(EXIT_SUCCESS);
    default: exit(2);
    }
}

static void read_options(struct service_options *o, int argc, char **argv)
{
    static const struct option known[] = {
        { "airyd", required_argument, NULL, OPT_AIRYD },
        { "airy", required_argument, NULL, OPT_AIRY },
        { "readme", required_argument, NULL, OPT_README },
        { "seconds", required_argument, NULL, OPT_SECONDS },
        { "rounds", required_argument, NULL, OPT_ROUNDS },
        { "users", required_argument, NULL, OPT_USERS },
        { "connections", required_argument, NULL, OPT_CONNECTIONS },
        { "kills", required_argument, NULL, OPT_KILLS },
        { "frames", required_argument, NULL, OPT_FRAMES },
        { "flight", required_argument, NULL, OPT_FLIGHT },
        { "help", no_argument, NULL, OPT_HELP },
        { NULL, 0, NULL, 0 },
    };
    int id;
    while ((id = getopt_long(argc, argv, "", known, NULL)) != -1)
        take_option(o, id, optarg);
}

static unsigned parts_named(int n, char **names)
{
    static const char *const known[] = { "load", "held", "kill", "memory", "python" };
    unsigned parts = 0;
    for (int i = 0; i < n; i++) {
        unsigned k = 0;
        while (k < sizeof known / sizeof known[0] && strcmp(known[k], names[i]))
            k++;
        if (k == sizeof known / sizeof known[0])
            die("\"%s\": expected load, held, kill, memory or python", names[i]);
        parts |= 1u << k;
    }
    return parts ? parts : PART_ALL;
}

// The first example of the manual: what a user types before one frame is bloomed and written.
static void count_python(const char *path)
{
    char line[512];
    unsigned lines = 0, written = 0;
    bool inside = false;
    FILE *file = fopen(path, "re");
    if (!file)
        die("%s cannot be read", path);
    while (fgets(line, sizeof line, file)) {
        if (!strncmp(line, "```", 3)) {
            if (inside)
                break;
            inside = !strncmp(line, "```python", 9);
            continue;
        }
        const char *text = line + strspn(line, " ");
        lines += inside && *text != '#' && *text != '\n';
        if (inside && !written && strstr(line, ".save("))
            written = lines;
    }
    fclose(file);
    if (!written)
        die("%s: no example that saves a frame", path);
    printf("\nPython: the first example of %s has %u lines; after line %u the frame is written\n", path, lines, written);
}

static void print_machine(void)
{
    char cpu[128];
    struct utsname system;
    double load[3] = { 0 };
    const unsigned cores = bench_pin();
    bench_cpu(cpu, sizeof cpu);
    if (uname(&system) < 0 || getloadavg(load, 3) < 0)
        die("no words about this machine");
    printf("airyd as a service: %u cores of %s, %s %s, load %.2f when it began\n", cores, cpu, system.sysname, system.release, load[0]);
}

int main(int argc, char **argv)
{
    struct service_options o = { .airyd = "build/airyd", .airy = "build/airy", .readme = "client/python/README.md", .seconds = 6, .rounds = 3,
                                 .users = 8, .connections = 10000, .kills = 20, .frames = 100000, .flight = 32 };
    read_options(&o, argc, argv);
    const unsigned parts = parts_named(argc - optind, argv + optind);
    print_machine();
    struct team *team = team_create();
    if (parts & PART_LOAD)
        measure_load(&o, team);
    if (parts & PART_HELD)
        measure_connections(&o, team);
    if (parts & PART_KILL)
        measure_kills(&o, team);
    if (parts & PART_MEMORY)
        measure_memory(&o, team);
    if (parts & PART_PYTHON)
        count_python(o.readme);
    team_destroy(team);
    return fflush(stdout) ? EXIT_FAILURE : EXIT_SUCCESS;
}
