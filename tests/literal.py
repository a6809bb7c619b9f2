"""Every equation of the radio once more, as it is written: plain loops over plain numbers, for one cell.

Tests hold the compiled kernels against these; the package never imports them. Channels are lists of rows, h[k][m] and
so on; labels are those of the paper.
"""

import cmath
import math

LIGHT_M_PER_S = 299_792_458.0
LINEAR_ITERATIONS = 2
"""Iterations of the closed-form phases that go for the sum of the gains."""
HAIR = 1 + 1e-12
"""Powers exceed what a rate takes by that much, so that rounding never leaves it below its QoS."""


# Links


def path_loss_db(table, distance_m, obstacles, carrier_hz):
    """Eq. (LoS), (NLoS) of the paper, or TR 38.901 table 7.4.1-1 for an indoor office."""
    d, mhz, ghz = math.log10(max(distance_m, 1.0)), carrier_hz / 1e6, carrier_hz / 1e9
    if table == "paper":
        if obstacles == 0:
            return 16.9 * d - 27.2 + 20 * math.log10(mhz)
        return 20 * math.log10(mhz) - 28 + 25.5 * d + 15 + 4 * (obstacles - 1)
    clear = 32.4 + 17.3 * d + 20 * math.log10(ghz)
    return clear if obstacles == 0 else max(clear, 17.3 + 38.3 * d + 24.9 * math.log10(ghz))


def pattern(kind, exponent, cosine):
    """Power gain of an element toward an angle from its normal."""
    if kind == "isotropic":
        return 1.0
    return 2 * (exponent + 1) * cosine**exponent if cosine > 0 else 0.0


def through_materials_db(table, distance_m, lost_db, carrier_hz):
    """Through everything in the way, or around it as behind one obstacle."""
    through = path_loss_db(table, distance_m, 0, carrier_hz) + lost_db
    around = max(path_loss_db(table, distance_m, n, carrier_hz) for n in (0, 1))
    return min(through, around) if lost_db > 0 else through


def rician_k(radio, obstacles):
    """Of a link behind obstacles, counted or in dB."""
    k = 10 ** (radio.rician_k_db / 10)
    if radio.obstacles == "materials":
        return k * 10 ** (-obstacles / 10)
    return 0 if obstacles else k


def mean_gain(radio, end, panel, heading, obstacles):
    """Power gain of the link from an end to a panel, or to the AP where `heading` is None."""
    loss = through_materials_db if radio.obstacles == "materials" else path_loss_db
    gain = 10 ** (-loss(radio.link_table, math.dist(end, panel), obstacles, radio.carrier_hz) / 10)
    if heading is None:
        return gain
    away = [a - b for a, b in zip(end, panel, strict=True)]
    ahead = math.cos(heading) * away[0] + math.sin(heading) * away[1]
    return gain * pattern(radio.element_pattern, radio.element_exponent, ahead / max(math.hypot(*away), 1e-12))


def entry(gain, k, start, end, diffuse, wavelength_m):
    """Eq. (PL) with Rician fading of factor k around the phase of an entry's own distance; k = 0 is Rayleigh's."""
    specular = cmath.exp(-2j * math.pi * math.dist(start, end) / wavelength_m)
    return math.sqrt(gain) * (math.sqrt(k / (k + 1)) * specular + math.sqrt(1 / (k + 1)) * diffuse)


def array(centre, axis, count, spacing_m):
    """Places of antennas in a line."""
    return [
        [c + spacing_m * (i - (count - 1) / 2) * a for c, a in zip(centre, axis, strict=True)] for i in range(count)
    ]


def elements(centre, heading, rows, cols, spacing_m):
    """Places of a vertical panel's elements, row by row from the bottom."""
    places = []
    for row in range(rows):
        for col in range(cols):
            along, up = spacing_m * (col - (cols - 1) / 2), spacing_m * (row - (rows - 1) / 2)
            x, y = centre[0] - math.sin(heading) * along, centre[1] + math.cos(heading) * along
            places.append([x, y, centre[2] + up])
    return places


# The surface


def coefficient(radio, phase):
    """An entry of Θ, for the phase that an element is set to (arXiv 1907.06002 for the modulus)."""
    made = radio.surface
    if made.phase_bits:
        count, turned = 2**made.phase_bits, cmath.phase(cmath.exp(1j * phase))
        phase = min((2 * math.pi / count * i for i in range(-count, count)), key=lambda at: abs(at - turned))
    dip = ((math.sin(phase - math.radians(made.amplitude_offset_deg)) + 1) / 2) ** made.amplitude_steepness
    modulus = radio.element_amplitude * ((1 - made.least_amplitude) * dip + made.least_amplitude)
    return modulus * cmath.exp(1j * phase)


def effective(radio, direct, incident, reflected, phases):
    """H = h_d + h_r Θ G, the factor in eq. (yt)."""
    channel, through = [], [coefficient(radio, phase) for phase in phases]
    for own, onward in zip(direct, reflected, strict=True):
        row = []
        for m, path in enumerate(own):
            row.append(path + sum(onward[n] * through[n] * incident[n][m] for n in range(len(phases))))
        channel.append(row)
    return channel


# Beams


def product(row, beam):
    """h g, without conjugation."""
    return sum(h * g for h, g in zip(row, beam, strict=True))


def norm(row):
    return math.sqrt(sum(abs(value) ** 2 for value in row))


def zero_forcing(rows):
    """Eq. (ZF): beams Hᴴ (H Hᴴ)⁻¹ of unit norm, by elimination."""
    gram = [[product(a, [value.conjugate() for value in b]) for b in rows] for a in rows]
    beams = []
    for s in range(len(rows)):
        weights = solve(gram, [1.0 if i == s else 0.0 for i in range(len(rows))])
        beam = [sum(rows[i][m].conjugate() * weights[i] for i in range(len(rows))) for m in range(len(rows[0]))]
        length = norm(beam)
        beams.append([value / length for value in beam])
    return beams


def solve(matrix, right):
    """The solution of a system of linear equations, by Gauss and Jordan with pivots."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(len(rows)):
        best = max(range(i, len(rows)), key=lambda r: abs(rows[r][i]))
        rows[i], rows[best] = rows[best], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for r in range(len(rows)):
            if r != i:
                rows[r] = [a - rows[r][i] * b for a, b in zip(rows[r], rows[i], strict=True)]
    return [row[-1] for row in rows]


def cluster_beams(known, clusters):
    """Eq. (ZFNOMA): the beam of every cluster, for its strongest user."""
    return zero_forcing([known[max(users, key=lambda user: norm(known[user]))] for users in clusters])


# Rates


def gains(channel, known, powers, clusters, noise_w):
    """e_k of eq. (SINROMA) over a channel, with beams that follow from what is known of it: by user."""
    beams, found = cluster_beams(known, clusters), {}
    for v, users in enumerate(clusters):
        for k in users:
            unwanted = noise_w
            for w, others in enumerate(clusters):
                if w != v:
                    unwanted += abs(product(channel[k], beams[w])) ** 2 * sum(powers[j] for j in others)
            found[k] = abs(product(channel[k], beams[v])) ** 2 / unwanted
    return found


def decoding_order(gain, clusters):
    """Users of every cluster from first decoded to last: by ascending gain."""
    return [sorted(users, key=lambda user: gain[user]) for users in clusters]


def cancelled(gain, powers, order, bandwidth_hz):
    """Rates by user where whoever is decoded later must decode a signal, too, and cancels it then."""
    rates = {}
    for users in order:
        for place, k in enumerate(users):
            later = sum(powers[j] for j in users[place + 1 :])
            decoders = [k, *(j for j in users[place + 1 :] if powers[j] > 0)]
            rates[k] = min(bandwidth_hz * math.log2(1 + gain[d] * powers[k] / (gain[d] * later + 1)) for d in decoders)
    return rates


def noma_rates(channel, powers, clusters, bandwidth_hz, noise_w, order=None, known=None):
    """Rates of all users with superposition in clusters."""
    known = channel if known is None else known
    if order is None:
        order = decoding_order(gains(known, known, powers, clusters, noise_w), clusters)
    rates = cancelled(gains(channel, known, powers, clusters, noise_w), powers, order, bandwidth_hz)
    return [rates[k] for k in range(len(channel))]


def oma_rates(channel, powers, clusters, bandwidth_hz, noise_w, known=None):
    """Rates of all users where each of a cluster's users has a band."""
    known, bands = channel if known is None else known, len(clusters[0])
    rates = [0.0] * len(channel)
    for band in range(bands):
        users = [cluster[band] for cluster in clusters]
        beams = zero_forcing([known[k] for k in users])
        for s, k in enumerate(users):
            got = [powers[j] * abs(product(channel[k], beams[i])) ** 2 for i, j in enumerate(users)]
            unwanted = sum(value for i, value in enumerate(got) if i != s) + noise_w / bands
            rates[k] = bandwidth_hz / bands * math.log2(1 + got[s] / unwanted)
    return rates


def rates_of(system, channel, powers, order=None, known=None):
    """Rates of a `System`, whose bandwidth is what pilots leave of it."""
    clusters = [list(map(int, users)) for users in system.clusters]
    if system.oma:
        selected = all(sum(powers[k] > 0 for k in users) == 1 for users in clusters)
        if not (system.selects and selected):
            return oma_rates(channel, powers, clusters, system.bandwidth_hz, system.noise_w, known)
    return noma_rates(channel, powers, clusters, system.bandwidth_hz, system.noise_w, order, known)


# Powers in closed form


def qos_first(gain, order, budgets, wanted_bps, bandwidth_hz):
    """What every user's rate takes over all later ones', where as much is left; the last has the rest."""
    powers = {}
    for users, left in zip(order, budgets, strict=True):
        for place, k in enumerate(users[:-1]):
            weakest = min(gain[j] for j in users[place:])
            sinr = 2 ** (wanted_bps[k] / bandwidth_hz) - 1
            power = HAIR * sinr * (left * weakest + 1) / (weakest * (1 + sinr)) if weakest > 0 else math.inf
            powers[k] = power if power <= left else 0.0
            left -= powers[k]
        powers[users[-1]] = left
    return powers


def qos_or_sum(system, known, wanted_bps, order=None):
    """`powers.qos_or_sum`: powers and rates of all users."""
    clusters = [list(map(int, users)) for users in system.clusters]
    users = range(len(known))
    if system.oma:
        powers = [system.tx_power_w / len(known)] * len(known)
        found = oma_rates(known, powers, clusters, system.bandwidth_hz, system.noise_w)
        if system.selects and min(found) < system.qos_bps:
            alone = strongest_alone(system, known, clusters)
            if sum(alone[1]) > sum(found):
                return alone
        return powers, found
    budgets = [system.tx_power_w / len(clusters)] * len(clusters)
    spent = [system.tx_power_w / len(known)] * len(known)  # gains ask only for what clusters spend in all
    gain = gains(known, known, spent, clusters, system.noise_w)
    decoded = decoding_order(gain, clusters) if order is None else order
    if system.qos_bps > 0:
        for wanted in (wanted_bps, [system.qos_bps] * len(known)):
            powers = qos_first(gain, decoded, budgets, wanted, system.bandwidth_hz)
            found = cancelled(gain, powers, decoded, system.bandwidth_hz)
            if min(found.values()) >= system.qos_bps:
                return [powers[k] for k in users], [found[k] for k in users]
    return strongest_alone(system, known, clusters)


def strongest_alone(system, known, clusters):
    """All of a cluster's power for its strongest user: powers and rates."""
    spent = [system.tx_power_w / len(known)] * len(known)
    gain, powers = gains(known, known, spent, clusters, system.noise_w), [0.0] * len(known)
    for users in clusters:
        powers[max(users, key=lambda user: gain[user])] = system.tx_power_w / len(clusters)
    return powers, noma_rates(known, powers, clusters, system.bandwidth_hz, system.noise_w)


# Phases in closed form


def aligned(incident, reflected, beams, toward, phases):
    """Phases that turn Σ_k w_k (h_r,k)_n (G g_k)_n real, as they are where nothing pulls."""
    turned = []
    for n, phase in enumerate(phases):
        pull = sum(toward[k] * reflected[k][n] * product(incident[n], beam) for k, beam in enumerate(beams))
        turned.append(-cmath.phase(pull) if abs(pull) > 0 else phase)
    return turned


def aligned_phases(radio, direct, incident, reflected, weights, iterations):
    """`closed_forms.aligned_phases`."""
    phases = [0.0] * len(incident)
    channel = direct
    for _ in range(iterations + 1):
        beams = [[value.conjugate() for value in row] for row in channel]
        phases = aligned(incident, reflected, beams, weights, phases)
        channel = effective(radio, direct, incident, reflected, phases)
    return phases


def qos_aligned_phases(system, radio, direct, incident, reflected, weights, order=None, iterations=7):
    """`closed_forms.qos_aligned_phases`."""
    clusters, users = [list(map(int, each)) for each in system.clusters], range(len(direct))
    best, kept = -math.inf, [0.0] * len(incident)
    for rank in range(len(clusters[0])):
        toward = [0.0] * len(direct)
        for each in clusters:
            falling = sorted(each, key=lambda user: -norm(direct[user]))
            for place, k in enumerate(falling):
                toward[k] = (weights[k] if place == rank else -1 / weights[k]) / norm(direct[k]) ** 2
        beams = [[value.conjugate() for value in row] for row in direct]
        phases = aligned(incident, reflected, beams, toward, [0.0] * len(incident))
        raised = list(weights)
        for iteration in range(iterations):
            channel = effective(radio, direct, incident, reflected, phases)
            powers, found = qos_or_sum(system, channel, [system.qos_bps] * len(direct), order)
            score = sum(found) + (1e12 if min(found) >= system.qos_bps else 0)
            if score > best:
                best, kept = score, phases
            beams = beams_of_users(system, channel, clusters, powers)
            own = [product(channel[k], beams[k]) for k in users]
            if iteration >= LINEAR_ITERATIONS:
                raised = [raised[k] * (2 if found[k] < system.qos_bps else 1) for k in users]
                toward = [raised[k] / own[k] for k in users]
            else:
                toward = [raised[k] * own[k].conjugate() for k in users]
            phases = aligned(incident, reflected, beams, toward, phases)
    return kept


def beams_of_users(system, channel, clusters, powers):
    """The beam of every user: its band's, or its cluster's where it is superposed or selected."""
    beams = [[] for _ in channel]
    if system.oma and not (system.selects and any(power == 0 for power in powers)):
        for band in range(len(clusters[0])):
            users = [cluster[band] for cluster in clusters]
            for k, beam in zip(users, zero_forcing([channel[k] for k in users]), strict=True):
                beams[k] = beam
    else:
        for users, beam in zip(clusters, cluster_beams(channel, clusters), strict=True):
            for k in users:
                beams[k] = beam
    return beams


# What a place is worth


def mean_element(radio):
    """What elements do toward the phases that are wanted of them, and their power, over 720 of these."""
    wanted = [2 * math.pi * (i + 0.5) / 720 for i in range(720)]
    sent = [coefficient(radio, phase) for phase in wanted]
    toward = [(value * cmath.exp(-1j * phase)).real for value, phase in zip(sent, wanted, strict=True)]
    alive, noise = 1 - radio.surface.dead_share, math.radians(radio.surface.phase_noise_deg)
    coherent = alive * math.exp(-(noise**2) / 2) * sum(toward) / len(toward)
    return coherent, alive * sum(abs(value) ** 2 for value in sent) / len(sent)


def predicted_rates(system, radio, direct, panels):
    """Rates from mean power gains: `direct` ones, and for every panel its elements, the AP's link and the users'."""
    clusters, users = [list(map(int, each)) for each in system.clusters], range(len(direct))
    over_noise, (coherent, mean_power) = [], mean_element(radio)
    for k in users:
        amplitude, power = math.sqrt(direct[k]), 0.0
        for count, incident, reflected in panels:
            gain, in_phase = incident * reflected[k], count / len(clusters)
            amplitude += in_phase * coherent * math.sqrt(gain)
            power += (count * mean_power - in_phase * coherent**2) * gain
        over_noise.append((amplitude**2 + power) / radio.noise_w)
    beam_gain, size = radio.num_antennas - len(clusters) + 1, len(clusters[0])
    if system.oma:
        share = size * radio.tx_power_w / len(direct)
        return [system.bandwidth_hz / size * math.log2(1 + beam_gain * gain * share) for gain in over_noise]
    rates = [0.0] * len(direct)
    for each in clusters:
        order = sorted(each, key=lambda user: over_noise[user])
        gain = {k: over_noise[k] * (beam_gain if k == order[-1] else 1) for k in order}
        wanted = dict.fromkeys(order, system.qos_bps)
        powers = qos_first(gain, [order], [radio.tx_power_w / len(clusters)], wanted, system.bandwidth_hz)
        for place, k in enumerate(order):
            later = sum(powers[j] for j in order[place + 1 :])
            rates[k] = system.bandwidth_hz * math.log2(1 + gain[k] * powers[k] / (gain[k] * later + 1))
    if min(rates) >= system.qos_bps:
        return rates
    alone, power = [0.0] * len(direct), radio.tx_power_w / len(clusters)
    for each in clusters:
        k = max(each, key=lambda user: over_noise[user])
        alone[k] = system.bandwidth_hz * math.log2(1 + beam_gain * over_noise[k] * power)
    return alone


def penalised(rates, qos_bps, penalty):
    """Eq. (R)."""
    return sum(rates) / (penalty if min(rates) < qos_bps else 1)
