// SPDX-License-Identifier: Apache-2.0
/*
 * airy_bench.c - speed, error and memory on this machine: `make bench`. See bench.h for how things are
 * compared.
 *
 * Everything runs on two cores, whatever the machine has: the figures are ratios to floors that have two
 * threads, and a daemon with more would be another race.
 */
#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "airy.h"
#include "bench.h"

enum { ROUNDS = 7, ROUNDS_QUICK = 3 };

static const char usage[] =
    "Usage: airy_bench [--quick] [--rounds N] [--airyd PATH] [--device WHICH] [--csv FILE]\n"
    "Measures the engine and the daemon against memcpy, a C chain and the codec alone, and the engine's "
    "error.\n\n"
    "      --quick         1080p only, 3 rounds, fewer sigmas and phases\n"
    "      --rounds N      turns of each comparison, 3 to 64 (default 7)\n"
    "      --airyd PATH    the daemon (default build/airyd)\n"
    "      --device WHICH  as airyd's\n"
    "      --csv FILE      all figures, one a line\n";

static void machine(const struct bench *b, unsigned used)
{
    char model[200], line[1400];
    struct utsname u;
    uname(&u);
    bench_cpu(model, sizeof model);
    const struct bloom_device_info *d = bloom_device(b->engine);
    snprintf(line, sizeof line,
             "%s, %u of %ld cores used; device %s; %s; airyd %s; compiler %s; %s %s, %u rounds", model,
             used, sysconf(_SC_NPROCESSORS_ONLN), d->name, d->driver, AIRY_VERSION, __VERSION__,
             u.sysname, u.release, b->rounds);
    printf("%s\n", line);
    csv_text("machine", "machine", line);
}

static void measure_size(struct bench *b, uint32_t width, uint32_t height)
{
    struct bench_frame f;
    frame_make(&f, width, height, b->team);
    csv_line("scene", f.size, "pixels above 1", "share", f.bright_share, "of all");
    measure_engine(b, &f);
    measure_daemon(b, &f);
    frame_finish(&f);
}

static void read_options(struct bench *b, const char **csv, int argc, char **argv)
{
    static const struct option known[] = {
        { "quick", no_argument, NULL, 'q' },
        { "rounds", required_argument, NULL, 'r' },
        { "airyd", required_argument, NULL, 'a' },
        { "device", required_argument, NULL, 'd' },
        { "csv", required_argument, NULL, 'c' },
        { "help", no_argument, NULL, 'h' },
        { NULL, 0, NULL, 0 },
    };
    for (int id; (id = getopt_long(argc, argv, "", known, NULL)) != -1;) {
        switch (id) {
        case 'q':
            b->quick = true;
            break;
        case 'r':
            b->rounds = (unsigned)strtoul(optarg, NULL, 10);
            break;
        case 'a':
            b->airyd = optarg;
            break;
        case 'd':
            b->device = optarg;
            break;
        case 'c':
            *csv = optarg;
            break;
        case 'h':
            fputs(usage, stdout);
            exit(EXIT_SUCCESS);
        default:
            fputs(usage, stderr);
            exit(2);
        }
    }
    if (!b->rounds)
        b->rounds = b->quick ? ROUNDS_QUICK : ROUNDS;
    if (optind < argc || b->rounds < 3 || b->rounds > ROUNDS_MAX) {
        fputs(usage, stderr);
        exit(2);
    }
}

int main(int argc, char **argv)
{
    struct bench b = { .airyd = "build/airyd" };
    const char *csv = NULL;
    struct fault f;
    read_options(&b, &csv, argc, argv);
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (access(b.airyd, X_OK))
        die("%s: %s", b.airyd, strerror(errno)); // now, and not after the engine's turn
    csv_open(csv);
    unsigned used = bench_pin();
    double t0 = now_ms();
    b.team = team_create();
    const struct bloom_options options = { .device = b.device, .slots = 2 };
    if (bloom_create(&b.engine, &options, &f) < 0)
        die("%s", f.text);
    machine(&b, used);
    chain_check(b.team);
    printf("\n");
    measure_size(&b, 1920, 1080);
    if (!b.quick)
        measure_size(&b, 3840, 2160);
    measure_error(&b);
    bloom_destroy(b.engine);
    team_destroy(b.team);
    printf("%.0f s; ratios are medians of the ratios within each turn\n", (now_ms() - t0) * 1e-3);
    csv_close();
    return EXIT_SUCCESS;
}
